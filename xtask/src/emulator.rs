//! `cargo xtask qemu-test`: the firmware in QEMU, driven by a Python client.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::board::{self, Board};
use crate::error::Error;
use crate::firmware::{APPLICATION, BOOTLOADER, build, checked};
use crate::image::Image;
use crate::pack::Files;
use crate::toolchain::{Toolchain, in_path};

/// The emulator's program.
pub(crate) const QEMU: &str = "qemu-system-arm";

/// Makes sure that the emulator is there.
pub(crate) fn require() -> Result<(), Error> {
    if in_path(QEMU) {
        Ok(())
    } else {
        Err(Error::Missing {
            program: QEMU,
            hint: "apt-get install qemu-system-arm",
        })
    }
}

/// The emulator with an image that reports through semihosting and ends by itself.
pub(crate) fn qemu(elf: &Path) -> Command {
    let mut qemu = Command::new(QEMU);
    qemu.args(["-M", "netduinoplus2", "-display", "none"])
        .args(["-monitor", "none", "-serial", "none"])
        .args(["-semihosting-config", "enable=on,target=native"])
        .arg("-kernel")
        .arg(elf);
    qemu
}

/// What the tests have measured: lines of a name and a number.
#[derive(Debug, PartialEq)]
pub(crate) struct Figures(Vec<(String, f64)>);

impl Figures {
    fn parse(text: &str) -> Self {
        let figure = |line: &str| {
            let (name, value) = line.split_once(' ')?;
            Some((name.to_owned(), value.parse().ok()?))
        };
        Self(text.lines().filter_map(figure).collect())
    }

    /// The largest of a name; 0 if there is none.
    pub(crate) fn most(&self, name: &str) -> f64 {
        let of_name = self.0.iter().filter(|(candidate, _)| candidate == name);
        of_name.fold(0.0, |most, (_, value)| value.max(most))
    }
}

/// Builds the image of the emulated board and runs the Python tests against it. `names` are unittest
/// names; none runs all.
pub(crate) fn test(names: &[String]) -> Result<(), Error> {
    require()?;
    let toolchain = Toolchain::find()?;
    let board = board::find(board::EMULATED)?;
    let image = Image::read(&build(&toolchain, &board, APPLICATION)?)?;
    test_image(&toolchain, &board, &image, names).map(|_| ())
}

/// Runs the Python tests against an application and the bootloader, which is built, and gives what they have measured.
pub(crate) fn test_image(
    toolchain: &Toolchain,
    board: &Board,
    image: &Image,
    names: &[String],
) -> Result<Figures, Error> {
    require()?;
    let signed = build(toolchain, &board.with_signatures(true), BOOTLOADER)?;
    let bootloader = build(toolchain, board, BOOTLOADER)?;
    let files = Files::write(image.path(), image, &Image::read(&bootloader)?, board)?;
    let python = env::var("WINDLASS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut modules = Command::new(&python);
    modules.args(["-c", "import can, serial"]);
    checked(
        "python3 with python-can and pyserial",
        &mut modules,
        "install Python, then `pip install python-can pyserial`",
    )?;
    let figures = image.path().with_extension("figures");
    let failed = |cause| Error::File {
        path: figures.clone(),
        cause,
    };
    fs::write(&figures, "").map_err(failed)?;
    let mut tests = Command::new(&python);
    tests
        .current_dir(crate::root().join("firmware/emulation"))
        .env("WINDLASS_IMAGE", image.path())
        .env("WINDLASS_BOOTLOADER", bootloader)
        .env("WINDLASS_SIGNED_BOOTLOADER", signed)
        .env("WINDLASS_SLOT", files.slot)
        .env("WINDLASS_BINARY", files.binary)
        .env("WINDLASS_COMMAND", host_command()?)
        .env("WINDLASS_XTASK", env::current_exe().unwrap_or_default())
        .env("WINDLASS_FIGURES", &figures)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .args(["-m", "unittest", "-v"]);
    if names.is_empty() {
        tests.args([
            "test_firmware",
            "test_bootloader",
            "test_host",
            "test_signed",
        ]);
    } else {
        tests.args(names);
    }
    checked("the emulator test", &mut tests, "is Python installed?")?;
    fs::read_to_string(&figures)
        .map(|text| Figures::parse(&text))
        .map_err(failed)
}

/// Builds the `windlass` command, as cargo builds it for this machine, and gives its file.
fn host_command() -> Result<PathBuf, Error> {
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let folder =
        env::var_os("CARGO_TARGET_DIR").map_or_else(|| crate::root().join("target"), PathBuf::from);
    let mut build = Command::new(cargo);
    build
        .current_dir(crate::root())
        .args(["build", "--quiet", "--package", "windlass"])
        .args(["--bin", "windlass", "--target-dir"])
        .arg(&folder);
    checked("cargo", &mut build, "does the host's tool build?")?;
    Ok(folder.join("debug/windlass"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_figure_of_a_name_counts() {
        let figures = Figures::parse("stack 100\njitter 1.94\nstack 4000\nbroken\n");
        assert_eq!(figures.most("stack"), 4000.0);
        assert_eq!(figures.most("jitter"), 1.94);
        assert_eq!(figures.most("broken"), 0.0);
    }
}
