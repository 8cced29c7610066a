//! `cargo xtask firmware`: builds the image of one board.

use std::env;
use std::path::PathBuf;
use std::process::Command;

use crate::board::{self, Board};
use crate::calls::CallGraph;
use crate::error::Error;
use crate::image::{self, Image};
use crate::toolchain::{TARGET, Toolchain, in_path};

/// The application's program.
pub(crate) const APPLICATION: &str = "windlass-app";

/// Log of the application unless the environment says otherwise: its level, and the bytes of RAM in which frames
/// wait for the debug probe (the crate's own default is twice that).
const LOG_DEFAULTS: [(&str, &str); 2] = [("DEFMT_LOG", "info"), ("DEFMT_RTT_BUFFER_SIZE", "512")];

/// Writes images into chips.
const PROBE: &str = "probe-rs";

/// Builds for the board with this name, reports and gives the image's file.
pub(crate) fn run(name: &str) -> Result<PathBuf, Error> {
    let board = board::find(name)?;
    let toolchain = Toolchain::find()?;
    println!("board      {} ({})", board.name, board.about);
    println!("toolchain  {toolchain}");
    let elf = build(&toolchain, &board, APPLICATION)?;
    let image = Image::read(&elf)?;
    image::report(&image, &board)?;
    let panicking = CallGraph::read(&elf)?.callers("core::panicking");
    println!(
        "panics  called from {} functions of this image",
        panicking.len()
    );
    for function in panicking {
        println!("        {function}");
    }
    let (binary, hex) = image.write_beside(&elf)?;
    println!("\nelf  {}", elf.display());
    println!("bin  {} (application slot alone)", binary.display());
    println!("hex  {}", hex.display());
    if board.probe_chip.is_some() {
        println!("\nto flash it: cargo xtask flash --board {}", board.name);
    }
    Ok(elf)
}

/// Builds for the board with this name, writes the image into its chip with probe-rs and starts it.
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
    let elf = run(name)?;
    let hint = "is the probe connected and the board powered?";
    let mut download = Command::new(PROBE);
    download.args(["download", "--chip", chip]).arg(elf);
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
    Ok(folder.join(TARGET).join("firmware").join(program))
}

/// Tells cargo which program to build, for which board; the application with its log.
pub(crate) fn select(command: &mut Command, board: &Board, program: &str) {
    command
        .args(["--package", "windlass-firmware", "--profile", "firmware"])
        .args(["--bin", program])
        .arg("--features")
        .arg(format!("board-{}", board.name));
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
