//! Finds a compiler that can build for the microcontroller.
//!
//! Two kinds will do: one with the target's library (rustup's, after `rustup target add`), or one with
//! the sources of the library (Debian's rustc-web with rust-web-src), which then builds it itself.

use std::env;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::Error;

/// The target of every board.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";

/// Variables that would mix one toolchain with another.
const FOREIGN: [&str; 7] = [
    "CARGO",
    "RUSTUP_TOOLCHAIN",
    "RUSTFLAGS",
    "CARGO_ENCODED_RUSTFLAGS",
    "LD_LIBRARY_PATH",
    "RUSTDOC",
    "RUSTC_WRAPPER",
];

/// Makes the compiler note the stack frame of every function, in a section that is not part of the image, and the
/// crate `sha2` take the smaller of its implementations of SHA-512: the other one takes 27 KB of a bootloader that
/// has 32.
const FLAGS: &str = "-Zemit-stack-sizes --cfg sha2_backend_soft=\"compact\"";

/// How the target's library comes about.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Library {
    /// It is installed.
    Installed,
    /// It is built from its sources, and linked with this program.
    Built { linker: &'static str },
}

/// A toolchain that works.
#[derive(Clone, Debug)]
pub(crate) struct Toolchain {
    sysroot: PathBuf,
    library: Library,
}

impl Toolchain {
    /// Looks at the compiler in use, then at the system's.
    pub(crate) fn find() -> Result<Self, Error> {
        let mut sysroots = Vec::new();
        for compiler in compilers() {
            if let Some(sysroot) = sysroot(&compiler)
                && !sysroots.contains(&sysroot)
            {
                sysroots.push(sysroot);
            }
        }
        Self::choose(&sysroots, has_library, has_sources, in_path)
    }

    /// The first sysroot with the target's library, else the first with its sources. What is looked at on the
    /// disk is handed in.
    fn choose(
        sysroots: &[PathBuf],
        has_library: impl Fn(&Path) -> bool,
        has_sources: impl Fn(&Path) -> bool,
        in_path: impl Fn(&str) -> bool,
    ) -> Result<Self, Error> {
        if let Some(sysroot) = sysroots.iter().find(|sysroot| has_library(sysroot)) {
            return Ok(Self {
                sysroot: sysroot.clone(),
                library: Library::Installed,
            });
        }
        let Some(sysroot) = sysroots.iter().find(|sysroot| has_sources(sysroot)) else {
            let looked_at: Vec<String> = sysroots
                .iter()
                .map(|sysroot| sysroot.display().to_string())
                .collect();
            return Err(Error::NoToolchain {
                looked_at: looked_at.join(", "),
            });
        };
        let linker = ["arm-none-eabi-ld", "ld.lld"]
            .into_iter()
            .find(|linker| in_path(linker))
            .ok_or(Error::NoLinker)?;
        Ok(Self {
            sysroot: sysroot.clone(),
            library: Library::Built { linker },
        })
    }

    /// A cargo command of this toolchain for the target, with `folder` as target folder.
    pub(crate) fn cargo(&self, verb: &str, folder: &Path) -> Command {
        let mut command = Command::new(self.sysroot.join("bin/cargo"));
        for name in FOREIGN {
            command.env_remove(name);
        }
        command
            .current_dir(crate::root())
            .env("RUSTC", self.sysroot.join("bin/rustc"))
            // A released compiler notes stack frames and builds its library's sources only when it is told that this
            // is meant.
            .env("RUSTC_BOOTSTRAP", "1")
            .env("RUSTFLAGS", FLAGS)
            .arg(verb)
            .args(["--target", TARGET])
            .arg("--target-dir")
            .arg(folder);
        if let Library::Built { linker } = self.library {
            command
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker)
                .arg("-Zbuild-std=core");
        }
        command
    }
}

impl fmt::Display for Toolchain {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sysroot = self.sysroot.display();
        match self.library {
            Library::Installed => write!(formatter, "{sysroot}, with the target's library"),
            Library::Built { linker } => write!(
                formatter,
                "{sysroot}, which builds the target's library from its sources (linker {linker})"
            ),
        }
    }
}

/// Compilers to try, the one that cargo uses for this very program first.
fn compilers() -> Vec<PathBuf> {
    let mut compilers = Vec::new();
    if let Some(compiler) = env::var_os("RUSTC") {
        compilers.push(PathBuf::from(compiler));
    }
    compilers.push(PathBuf::from("rustc"));
    compilers.push(PathBuf::from("/usr/bin/rustc"));
    compilers
}

fn sysroot(compiler: &Path) -> Option<PathBuf> {
    let output = Command::new(compiler)
        .args(["--print", "sysroot"])
        .output()
        .ok()?;
    let path = PathBuf::from(String::from_utf8(output.stdout).ok()?.trim());
    (output.status.success() && path.join("bin/cargo").exists()).then_some(path)
}

fn has_library(sysroot: &Path) -> bool {
    sysroot
        .join("lib/rustlib")
        .join(TARGET)
        .join("lib")
        .is_dir()
}

fn has_sources(sysroot: &Path) -> bool {
    sysroot.join("lib/rustlib/src/rust/library/core").is_dir()
}

/// True if a program of this name can be found.
pub(crate) fn in_path(program: &str) -> bool {
    env::var_os("PATH")
        .is_some_and(|path| env::split_paths(&path).any(|folder| folder.join(program).is_file()))
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;

    use super::*;

    /// Chooses between rustup's and Debian's toolchain; the arguments name what has the library and the sources.
    fn choose(library: &str, sources: &str, linkers: &[&str]) -> Result<Toolchain, Error> {
        let is = |wanted: &str, path: &Path| path == Path::new(wanted);
        Toolchain::choose(
            &["/rustup".into(), "/usr".into()],
            |path| is(library, path),
            |path| is(sources, path),
            |linker| linkers.contains(&linker),
        )
    }

    fn arguments(toolchain: &Toolchain) -> (Command, Vec<String>) {
        let command = toolchain.cargo("build", Path::new("folder"));
        let arguments = command
            .get_args()
            .map(|argument| argument.to_string_lossy().into_owned())
            .collect();
        (command, arguments)
    }

    #[test]
    fn an_installed_library_wins_and_is_linked_with_the_compiler_s_own_linker() {
        let toolchain = choose("/rustup", "/usr", &["arm-none-eabi-ld"]).unwrap();
        assert_eq!(toolchain.library, Library::Installed);
        let (command, arguments) = arguments(&toolchain);
        assert_eq!(command.get_program(), "/rustup/bin/cargo");
        assert!(arguments.contains(&TARGET.to_owned()));
        assert!(
            !arguments
                .iter()
                .any(|argument| argument.contains("-Zbuild-std"))
        );
        let variable = |name: &str| command.get_envs().find(|(key, _)| *key == name);
        let compiler = variable("RUSTC").and_then(|(_, value)| value);
        assert_eq!(compiler.unwrap(), "/rustup/bin/rustc");
        assert_eq!(variable("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER"), None);
        // Nothing of the toolchain that runs this very program may leak into it.
        for name in FOREIGN {
            let own = (name == "RUSTFLAGS").then(|| OsStr::new(FLAGS));
            assert_eq!(variable(name).map(|(_, value)| value), Some(own), "{name}");
        }
    }

    #[test]
    fn the_library_is_built_from_its_sources_if_none_is_installed() {
        let toolchain = choose("", "/usr", &["ld.lld"]).unwrap();
        assert_eq!(toolchain.library, Library::Built { linker: "ld.lld" });
        let (command, arguments) = arguments(&toolchain);
        assert_eq!(command.get_program(), "/usr/bin/cargo");
        assert!(arguments.contains(&"-Zbuild-std=core".to_owned()));
        let both = choose("", "/usr", &["ld.lld", "arm-none-eabi-ld"]).unwrap();
        let linker = "arm-none-eabi-ld";
        assert_eq!(both.library, Library::Built { linker });
    }

    #[test]
    fn a_missing_toolchain_names_both_ways_and_a_missing_linker_its_package() {
        let message = choose("", "", &["ld.lld"]).unwrap_err().to_string();
        for part in ["rustup target add", "apt-get install", "/rustup, /usr"] {
            assert!(message.contains(part), "{message}");
        }
        let message = choose("", "/usr", &[]).unwrap_err().to_string();
        assert!(message.contains("binutils-arm-none-eabi"), "{message}");
    }
}
