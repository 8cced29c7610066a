//! `cargo xtask qemu-test`: the firmware in QEMU, driven by a Python client.

use std::env;
use std::path::Path;
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

/// Builds the image of the emulated board and runs the Python tests against it. `names` are unittest
/// names; none runs all.
pub(crate) fn test(names: &[String]) -> Result<(), Error> {
    require()?;
    let toolchain = Toolchain::find()?;
    let board = board::find(board::EMULATED)?;
    let elf = build(&toolchain, &board, APPLICATION)?;
    test_image(&toolchain, &board, &elf, names, None)
}

/// Runs the Python tests against an application and the bootloader, which is built. Each test appends the high-water
/// mark of the stack to the file `stack`, if there is one.
pub(crate) fn test_image(
    toolchain: &Toolchain,
    board: &Board,
    elf: &Path,
    names: &[String],
    stack: Option<&Path>,
) -> Result<(), Error> {
    require()?;
    let bootloader = build(toolchain, board, BOOTLOADER)?;
    let files = Files::write(elf, &Image::read(elf)?, &Image::read(&bootloader)?, board)?;
    let python = env::var("WINDLASS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut modules = Command::new(&python);
    modules.args(["-c", "import can, serial"]);
    checked(
        "python3 with python-can and pyserial",
        &mut modules,
        "install Python, then `pip install python-can pyserial`",
    )?;
    let mut tests = Command::new(&python);
    tests
        .current_dir(crate::root().join("firmware/emulation"))
        .env("WINDLASS_IMAGE", elf)
        .env("WINDLASS_BOOTLOADER", bootloader)
        .env("WINDLASS_SLOT", files.slot)
        .env("WINDLASS_BINARY", files.binary)
        .env("WINDLASS_XTASK", env::current_exe().unwrap_or_default())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .args(["-m", "unittest", "-v"]);
    if let Some(stack) = stack {
        tests.env("WINDLASS_STACK", stack);
    }
    if names.is_empty() {
        tests.args(["test_firmware", "test_bootloader"]);
    } else {
        tests.args(names);
    }
    checked("the emulator test", &mut tests, "is Python installed?")
}
