//! `cargo xtask firmware`: builds application and bootloader of one board.

use std::env;
use std::fs;
use std::io::{self, BufRead, BufReader, IsTerminal};
use std::path::PathBuf;
use std::process::{Command, ExitStatus, Stdio};

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
/// The program that checks signatures as the bootloader does.
pub(crate) const SIGNATURES: &str = "windlass-signatures";

/// Log of the application unless the environment says otherwise: its level, and the bytes of RAM in which frames
/// wait for the debug probe (the crate's own default is twice that).
const LOG_DEFAULTS: [(&str, &str); 2] = [("DEFMT_LOG", "info"), ("DEFMT_RTT_BUFFER_SIZE", "512")];

/// Writes images into chips.
const PROBE: &str = "probe-rs";

/// Builds for the board with this name, with a bootloader that checks signatures or without, reports and gives the
/// files.
pub(crate) fn run(name: &str, signed: bool) -> Result<Files, Error> {
    let board = board::find(name)?.with_signatures(signed);
    let toolchain = Toolchain::find()?;
    println!("board      {} ({})", board.name, board.about);
    println!("toolchain  {toolchain}");
    let bootloader = Image::read(&build(&toolchain, &board, BOOTLOADER)?)?;
    let checks = if signed {
        "checks signatures"
    } else {
        "checks no signatures"
    };
    println!("\nBOOTLOADER ({checks}; it links only if it cannot panic)");
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
        let signed = if signed { " --signed" } else { "" };
        println!(
            "\nto flash both: cargo xtask flash --board {}{signed}",
            board.name
        );
    }
    Ok(files)
}

/// Builds for the board with this name, writes bootloader and application into its chip with probe-rs and starts
/// it.
pub(crate) fn flash(name: &str, signed: bool) -> Result<(), Error> {
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
    let files = run(name, signed)?;
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
    let (status, excess) = watched(&mut command).map_err(|cause| Error::Start {
        program: "cargo".to_owned(),
        cause,
        hint: "is the toolchain complete?",
    })?;
    if let (false, Some(excess)) = (status.success(), excess) {
        return Err(too_large(board, program, excess));
    }
    if !status.success() {
        return Err(Error::Failed {
            program: "cargo".to_owned(),
            status,
        });
    }
    let built = folder.join(TARGET).join(profile(program)).join(program);
    if program != BOOTLOADER || !board.signed {
        return Ok(built);
    }
    // Cargo gives both bootloaders the same name.
    let named = built.with_file_name(format!("{program}-signed"));
    match fs::copy(&built, &named) {
        Ok(_) => Ok(named),
        Err(cause) => Err(Error::File { path: named, cause }),
    }
}

/// Runs a build whose messages are shown, and gives its end and by how many bytes the linker found a region to be too
/// small.
fn watched(command: &mut Command) -> io::Result<(ExitStatus, Option<u64>)> {
    if io::stderr().is_terminal() {
        command.env("CARGO_TERM_COLOR", "always");
    }
    let mut child = command.stderr(Stdio::piped()).spawn()?;
    let mut most = None;
    if let Some(messages) = child.stderr.take() {
        for line in BufReader::new(messages).split(b'\n') {
            let line = String::from_utf8_lossy(&line?).into_owned();
            most = most.max(excess(&line));
            eprintln!("{line}");
        }
    }
    Ok((child.wait()?, most))
}

/// By how many bytes a region is too small, by the message of GNU's or LLVM's linker.
fn excess(line: &str) -> Option<u64> {
    let (_, rest) = line.split_once("overflowed by ")?;
    rest.split(' ').next()?.parse().ok()
}

fn too_large(board: &Board, program: &str, excess: u64) -> Error {
    let region = if program == BOOTLOADER {
        "BOOT"
    } else {
        "FLASH"
    };
    let length = |board: &Board| image::region_of(board, region).map_or(0, |(_, length)| length);
    let own = length(board);
    let what = format!(
        "{excess} bytes more than the {own} of {region} in {}",
        board.map
    );
    if program != BOOTLOADER || !board.signed {
        return Error::TooLarge { what };
    }
    let others: Vec<&str> = board::BOARDS
        .iter()
        .filter(|other| other.budgeted && length(other) >= own + excess)
        .map(|other| other.name)
        .collect();
    Error::NoRoomForSignatures {
        board: board.name,
        what,
        others: others.join(", "),
    }
}

/// Profile that a program is built with.
pub(crate) fn profile(program: &str) -> &'static str {
    if program == BOOTLOADER || program == SIGNATURES {
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
        if board.signed {
            command.args(["--features", "signed"]);
        }
    }
    if program == SIGNATURES {
        command.args(["--features", "signed"]);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_linkers_tell_by_how_much_a_region_is_too_small() {
        let gnu = "arm-none-eabi-ld: region `BOOT' overflowed by 3072 bytes";
        let llvm = "rust-lld: error: section '.text' will not fit in region 'BOOT': overflowed by 4312 bytes";
        assert_eq!(excess(gnu), Some(3072));
        assert_eq!(excess(llvm), Some(4312));
        assert_eq!(excess("error: linking with `rust-lld` failed"), None);
    }

    #[test]
    fn a_bootloader_without_room_for_signatures_names_cause_and_next_step() {
        let board = board::find("b-g431b-esc1").unwrap();
        let message =
            |signed, program| too_large(&board.with_signatures(signed), program, 4000).to_string();
        let text = message(true, BOOTLOADER);
        for part in [
            "b-g431b-esc1",
            "4000 bytes more than the 20480 of BOOT",
            "without --signed",
            "f405-devkit, nucleo-g474re",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!message(false, BOOTLOADER).contains("--signed"));
        assert!(message(true, APPLICATION).contains("of FLASH"));
    }
}
