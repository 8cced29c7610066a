//! `cargo xtask firmware`: builds application and bootloader of one board.

use std::env;
use std::path::PathBuf;
use std::process::Command;

use crate::board::{self, Board};
use crate::calls::CallGraph;
use crate::error::Error;
use crate::image::{self, Image, Part};
use crate::pack::Files;
use crate::toolchain::{TARGET, Toolchain, in_path};

/// The application's program.
pub(crate) const APPLICATION: &str = "windlass-app";
/// The bootloader's program.
pub(crate) const BOOTLOADER: &str = "windlass-boot";

/// Log of the application unless the environment says otherwise: its level, and the bytes of RAM in which frames
/// wait for the debug probe (the crate's own default is twice that).
const LOG_DEFAULTS: [(&str, &str); 2] = [("DEFMT_LOG", "info"), ("DEFMT_RTT_BUFFER_SIZE", "512")];

/// Writes images into chips.
const PROBE: &str = "probe-rs";

/// Builds for the board with this name, reports and gives the files.
pub(crate) fn run(name: &str) -> Result<Files, Error> {
    let board = board::find(name)?;
    let toolchain = Toolchain::find()?;
    println!("board      {} ({})", board.name, board.about);
    println!("toolchain  {toolchain}");
    let bootloader = Image::read(&build(&toolchain, &board, BOOTLOADER)?)?;
    println!("\nBOOTLOADER (it links only if it cannot panic)");
    image::report(&bootloader, &board, Part::Bootloader)?;
    let elf = build(&toolchain, &board, APPLICATION)?;
    let image = Image::read(&elf)?;
    println!("\nAPPLICATION");
    image::report(&image, &board, Part::Application)?;
    let panicking = CallGraph::read(&elf)?.callers("core::panicking");
    println!(
        "panics  called from {} functions of this image",
        panicking.len()
    );
    for function in panicking {
        println!("        {function}");
    }
    let files = Files::write(&elf, &image, &bootloader, &board)?;
    println!("\nelf    {} (for debuggers)", elf.display());
    println!("       {}", bootloader.path().display());
    println!("bin    {} (application, sealed)", files.binary.display());
    println!(
        "hex    {} (application, sealed: for `windlass flash`)",
        files.hex.display()
    );
    println!(
        "hex    {} (bootloader and application, for the first flashing)",
        files.whole.display()
    );
    if board.probe_chip.is_some() {
        println!("\nto flash both: cargo xtask flash --board {}", board.name);
    }
    Ok(files)
}

/// Builds for the board with this name, writes bootloader and application into its chip with probe-rs and starts
/// it.
pub(crate) fn flash(name: &str) -> Result<(), Error> {
    let board = board::find(name)?;
    let Some(chip) = board.probe_chip else {
        return Err(Error::Emulated(board.name));
    };
    if !in_path(PROBE) {
        return Err(Error::Missing {
            program: PROBE,
            hint: "cargo install probe-rs-tools --locked",
        });
    }
    let files = run(name)?;
    let hint = "is the probe connected and the board powered?";
    let mut download = Command::new(PROBE);
    download
        .args(["download", "--chip", chip, "--binary-format", "hex"])
        .arg(files.whole);
    checked(PROBE, &mut download, hint)?;
    let mut reset = Command::new(PROBE);
    reset.args(["reset", "--chip", chip]);
    checked(PROBE, &mut reset, hint)
}

/// Builds one program for one board and gives its file.
pub(crate) fn build(toolchain: &Toolchain, board: &Board, program: &str) -> Result<PathBuf, Error> {
    let folder = crate::root().join("target/firmware").join(board.name);
    let mut command = toolchain.cargo("build", &folder);
    select(&mut command, board, program);
    checked("cargo", &mut command, "is the toolchain complete?")?;
    Ok(folder.join(TARGET).join(profile(program)).join(program))
}

/// Profile that a program is built with.
pub(crate) fn profile(program: &str) -> &'static str {
    if program == BOOTLOADER {
        "bootloader"
    } else {
        "firmware"
    }
}

/// Tells cargo which program to build, for which board; the application with its log.
pub(crate) fn select(command: &mut Command, board: &Board, program: &str) {
    command
        .args(["--package", "windlass-firmware"])
        .args(["--profile", profile(program)])
        .args(["--bin", program])
        .arg("--features")
        .arg(format!("board-{}", board.name));
    if program == BOOTLOADER {
        command.args(["--features", "bootloader"]);
    }
    if program == APPLICATION {
        command.args(["--features", "log"]);
        for (variable, value) in LOG_DEFAULTS {
            if env::var_os(variable).is_none() {
                command.env(variable, value);
            }
        }
    }
}

/// Runs a program to its end.
pub(crate) fn checked(
    program: &str,
    command: &mut Command,
    hint: &'static str,
) -> Result<(), Error> {
    let status = command.status().map_err(|cause| Error::Start {
        program: program.to_owned(),
        cause,
        hint,
    })?;
    if status.success() {
        Ok(())
    } else {
        Err(Error::Failed {
            program: program.to_owned(),
            status,
        })
    }
}
