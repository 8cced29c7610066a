//! `cargo xtask no-panic`: no function of the core can panic.
//!
//! First the core is built without link-time optimisation, so that its library holds every one of its
//! functions as machine code. Then an image is linked that has all of them as roots and a panic handler
//! that is declared but does not exist: it links only if nothing reaches the handler.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use object::read::archive::ArchiveFile;
use object::read::elf::ElfFile32;
use object::{Object, ObjectSymbol, SymbolKind};

use crate::board;
use crate::error::Error;
use crate::firmware::checked;
use crate::image::Image;
use crate::toolchain::{TARGET, Toolchain};

/// The program whose panic handler does not exist.
const PROGRAM: &str = "windlass-no-panic";

/// Builds, collects the roots and links.
pub(crate) fn run() -> Result<(), Error> {
    let toolchain = Toolchain::find()?;
    let folder = crate::root().join("target/firmware/no-panic");
    link(&toolchain, &folder, None)?;
    let release = folder.join(TARGET).join("firmware");
    let library = core_library(&release.join("deps"))?;
    let roots = functions(&library)?;
    // The name changes with the roots, so that cargo links again when they do.
    let script = folder.join(format!("roots-{:016x}.x", fingerprint(&roots)));
    let text: String = roots
        .iter()
        .map(|root| format!("EXTERN({root});\n"))
        .collect();
    fs::write(&script, text).map_err(|cause| Error::File {
        path: script.clone(),
        cause,
    })?;
    link(&toolchain, &folder, Some(&script))?;
    let image = Image::read(&release.join(PROGRAM))?;
    let linked = image
        .symbols
        .iter()
        .filter(|(name, _)| roots.contains(name))
        .count();
    if linked < roots.len() {
        return Err(Error::Image {
            path: release.join(PROGRAM),
            what: format!(
                "only {linked} of {} functions of the core are in it",
                roots.len()
            ),
        });
    }
    println!("{linked} functions of the core are linked, and none of them can reach a panic");
    Ok(())
}

fn link(toolchain: &Toolchain, folder: &Path, script: Option<&Path>) -> Result<(), Error> {
    let board = board::find("qemu")?;
    let mut command = toolchain.cargo("rustc", folder);
    command
        .args(["--config", "profile.firmware.lto='off'"])
        .args(["--package", "windlass-firmware", "--profile", "firmware"])
        .args(["--bin", PROGRAM])
        .arg("--features")
        .arg(format!("board-{}", board.name));
    // Without this, small functions are compiled only where they are called, and some are called by nobody
    // here.
    command.env("RUSTFLAGS", "-Zcross-crate-inline-threshold=never");
    if let Some(script) = script {
        command
            .arg("--")
            .arg("-C")
            .arg(format!("link-arg=-T{}", script.display()));
    }
    checked(
        "cargo",
        &mut command,
        "if `a_panic_is_reachable` is undefined, a function named above can panic",
    )
}

/// The newest library of the core in a folder.
fn core_library(folder: &Path) -> Result<PathBuf, Error> {
    let entries = fs::read_dir(folder).map_err(|cause| Error::File {
        path: folder.to_owned(),
        cause,
    })?;
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("libwindlass_core-") && name.ends_with(".rlib")
        })
        .max_by_key(|path| path.metadata().and_then(|data| data.modified()).ok())
        .ok_or_else(|| Error::Image {
            path: folder.to_owned(),
            what: "it holds no library of the core".to_owned(),
        })
}

/// Every global function that a library defines.
fn functions(library: &Path) -> Result<BTreeSet<String>, Error> {
    let bytes = fs::read(library).map_err(|cause| Error::File {
        path: library.to_owned(),
        cause,
    })?;
    let broken = |error: object::Error| Error::Image {
        path: library.to_owned(),
        what: error.to_string(),
    };
    let archive = ArchiveFile::parse(&*bytes).map_err(broken)?;
    let mut found = BTreeSet::new();
    for member in archive.members() {
        let data = member
            .and_then(|member| member.data(&*bytes))
            .map_err(broken)?;
        // A copy, because members of an archive are not aligned as the reader wants them.
        let data = data.to_vec();
        // The archive also holds the compiler's metadata, which is no object.
        let Ok(file) = ElfFile32::<object::LittleEndian>::parse(&*data) else {
            continue;
        };
        for symbol in file.symbols() {
            if symbol.kind() == SymbolKind::Text && symbol.is_global() && symbol.is_definition() {
                found.extend(symbol.name().map(str::to_owned));
            }
        }
    }
    Ok(found)
}

fn fingerprint(roots: &BTreeSet<String>) -> u64 {
    use std::hash::{DefaultHasher, Hash, Hasher};
    let mut hasher = DefaultHasher::new();
    roots.hash(&mut hasher);
    hasher.finish()
}
