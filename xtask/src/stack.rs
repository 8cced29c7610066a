//! `cargo xtask stack`: how much stack the firmware can need, and how much it was seen to need.

use std::fs;
use std::path::Path;

use crate::board::{self, Board};
use crate::calls::{CallGraph, Depth};
use crate::emulator;
use crate::error::Error;
use crate::firmware::{APPLICATION, checked, select};
use crate::image::Image;
use crate::toolchain::{TARGET, Toolchain};

/// What the processor pushes for an interrupt, with floating-point registers and alignment (ARMv7-M
/// Architecture Reference Manual, B1.5.7): 26 words, aligned to 8 bytes.
const EXCEPTION_FRAME: u64 = 112;
/// Tests that are run for the high-water mark.
const TESTS: [&str; 1] = ["test_firmware.Management"];

/// Prints the static figure of a board, and what was seen of the emulated one; more than the region is an error.
pub(crate) fn run(name: &str) -> Result<(), Error> {
    let board = board::find(name)?;
    let toolchain = Toolchain::find()?;
    let folder = crate::root().join("target/firmware/stack").join(board.name);
    let mut command = toolchain.cargo("build", &folder);
    command
        .env("RUSTC_BOOTSTRAP", "1")
        .env("RUSTFLAGS", "-Zemit-stack-sizes");
    select(&mut command, &board, APPLICATION);
    checked("cargo", &mut command, "is the toolchain complete?")?;
    let elf = folder.join(TARGET).join("firmware").join(APPLICATION);
    let image = Image::read(&elf)?;
    let region = image.symbol("_stack_start")? - image.symbol("_stack_end")?;
    let graph = CallGraph::read(&elf)?;
    let depth = |name: &str| {
        graph.depth(name).ok_or_else(|| Error::Image {
            path: elf.clone(),
            what: format!("it has no function {name}"),
        })
    };
    let mut total = show("thread mode", &depth("main")?);
    for handlers in board.handlers {
        let mut deepest = 0;
        for handler in *handlers {
            deepest = deepest.max(show(handler, &depth(handler)?));
        }
        total += deepest + EXCEPTION_FRAME;
    }
    println!("static worst case {total} bytes (with {EXCEPTION_FRAME} pushed for each interrupt)");
    if board.name == board::EMULATED {
        println!(
            "high-water mark   {} bytes",
            high_water(&toolchain, &board, &folder, &elf)?
        );
    } else {
        println!("high-water mark   not known: this board is not emulated");
    }
    println!("region            {region} bytes");
    if total > region {
        return Err(Error::TooLarge {
            what: format!("stack {total} of {region} bytes"),
        });
    }
    Ok(())
}

/// The most that the emulator's tests have needed.
fn high_water(
    toolchain: &Toolchain,
    board: &Board,
    folder: &Path,
    elf: &Path,
) -> Result<u64, Error> {
    let seen = folder.join("high-water.txt");
    let failed = |cause| Error::File {
        path: seen.clone(),
        cause,
    };
    fs::write(&seen, "").map_err(failed)?;
    emulator::test_image(
        toolchain,
        board,
        elf,
        &TESTS.map(str::to_owned),
        Some(&seen),
    )?;
    let text = fs::read_to_string(&seen).map_err(failed)?;
    Ok(text
        .lines()
        .filter_map(|line| line.parse().ok())
        .max()
        .unwrap_or(0))
}

fn show(name: &str, depth: &Depth) -> u64 {
    println!("{name}: {} bytes", depth.bytes);
    for (function, frame) in depth.chain.iter().filter(|(_, frame)| *frame >= 100) {
        println!("    {frame:>5} {:#}", rustc_demangle::demangle(function));
    }
    for (what, functions) in [
        ("frame unknown, taken as 64 bytes", &depth.unknown),
        ("calls through a register, not followed", &depth.indirect),
        ("can call itself, counted once", &depth.recursive),
    ] {
        if !functions.is_empty() {
            let names: Vec<&str> = functions.iter().map(String::as_str).collect();
            println!("    {what}: {}", names.join(", "));
        }
    }
    depth.bytes
}
