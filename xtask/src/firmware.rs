//! `cargo xtask firmware`: builds the image of one board.

use std::path::PathBuf;
use std::process::Command;

use crate::board::{self, Board};
use crate::calls::CallGraph;
use crate::error::Error;
use crate::image::{self, Image};
use crate::toolchain::{TARGET, Toolchain};

/// The application's program.
pub(crate) const APPLICATION: &str = "windlass-app";

/// Builds for the board with this name and reports.
pub(crate) fn run(name: &str) -> Result<(), Error> {
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
    if let Some(chip) = board.probe_chip {
        println!(
            "\nto flash it: probe-rs run --chip {chip} {}",
            elf.display()
        );
    }
    Ok(())
}

/// Builds one program for one board and gives its file.
pub(crate) fn build(toolchain: &Toolchain, board: &Board, program: &str) -> Result<PathBuf, Error> {
    let folder = crate::root().join("target/firmware").join(board.name);
    let mut command = toolchain.cargo("build", &folder);
    command
        .args(["--package", "windlass-firmware", "--profile", "firmware"])
        .args(["--bin", program])
        .arg("--features")
        .arg(format!("board-{}", board.name));
    checked("cargo", &mut command, "is the toolchain complete?")?;
    Ok(folder.join(TARGET).join("firmware").join(program))
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
