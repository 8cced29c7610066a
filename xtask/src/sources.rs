//! `cargo xtask sources`: which part of the sources the machine code of a bootloader comes from.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

use crate::board;
use crate::error::Error;
use crate::firmware::{BOOTLOADER, build};
use crate::image::Image;
use crate::toolchain::Toolchain;

/// Tells the lines of an address, the innermost inlined function first.
const LINES: &str = "arm-none-eabi-addr2line";
/// Folders of a source file that make a part, `core/src/boot/slots` for example.
const DEPTH: usize = 4;
/// Machine code that no line of the workspace stands for.
const OTHERS: &str = "start-up code, memory functions, compiler's library";
/// Bytes of the shortest instruction.
const STEP: u64 = 2;

/// Builds the bootloader of the board with this name and prints its bytes by part.
pub(crate) fn run(name: &str) -> Result<(), Error> {
    let board = board::find(name)?;
    let image = Image::read(&build(&Toolchain::find()?, &board, BOOTLOADER)?)?;
    let text = image
        .sections
        .iter()
        .find(|section| section.name == ".text");
    let text = text.ok_or_else(|| Error::Image {
        path: image.path().to_owned(),
        what: "it has no section .text".to_owned(),
    })?;
    let lines = lines(image.path(), text.address..text.address + text.size)?;
    let mut parts: Vec<(String, u64)> = by_part(&lines, &crate::root()).into_iter().collect();
    parts.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
    for (part, bytes) in parts {
        println!("{bytes:>7} {part}");
    }
    println!(
        "{:>7} constants, strings, vectors",
        image.flash() - text.size
    );
    println!("{:>7} in all", image.flash());
    Ok(())
}

/// What the tool for it tells of every address of a range.
fn lines(image: &Path, range: std::ops::Range<u64>) -> Result<String, Error> {
    let start = |cause| Error::Start {
        program: LINES.to_owned(),
        cause,
        hint: "apt-get install binutils-arm-none-eabi",
    };
    let mut tool = Command::new(LINES)
        .arg("--exe")
        .arg(image)
        .args(["--inlines", "--addresses"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(start)?;
    let mut input = tool.stdin.take();
    // From a thread of its own: the tool answers while it is asked, and would wait for its answers to be read.
    let questions = thread::spawn(move || {
        for address in range.step_by(STEP as usize) {
            if let Some(input) = &mut input {
                writeln!(input, "{address:#x}")?;
            }
        }
        Ok::<(), std::io::Error>(())
    });
    let output = tool.wait_with_output().map_err(start)?;
    if !matches!(questions.join(), Ok(Ok(()))) || !output.status.success() {
        return Err(Error::Failed {
            program: LINES.to_owned(),
            status: output.status,
        });
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Adds up the addresses by the innermost file of the workspace that each comes from. A constant between functions counts
/// with the line before it.
fn by_part(lines: &str, root: &Path) -> BTreeMap<String, u64> {
    let mut parts = BTreeMap::new();
    for address in lines.split("0x").skip(1) {
        let part = address
            .lines()
            .skip(1)
            .find_map(|line| part(Path::new(line.split(':').next()?), root));
        *parts
            .entry(part.unwrap_or_else(|| OTHERS.to_owned()))
            .or_insert(0) += STEP;
    }
    parts
}

/// The part that a file of the workspace belongs to.
fn part(file: &Path, root: &Path) -> Option<String> {
    let file = file.strip_prefix(root).ok()?;
    let folders: Vec<_> = file
        .iter()
        .take(DEPTH)
        .map(|name| name.to_string_lossy())
        .collect();
    Some(folders.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_count_for_the_innermost_file_of_the_workspace() {
        let lines = "0x08000040\n/rustc/library/core/src/option.rs:1\n/w/core/src/boot/slots/log.rs:7\n\
                     /w/core/src/boot/loader.rs:2\n\
                     0x08000042\n/w/core/src/boot/slots/mod.rs:3 (discriminator 1)\n\
                     0x08000044\n??:0\n\
                     0x08000046\n/w/core/src/crc.rs:?\n";
        let parts = by_part(lines, Path::new("/w"));
        let expected = [
            ("core/src/boot/slots", 4),
            ("core/src/crc.rs", 2),
            (OTHERS, 2),
        ];
        assert_eq!(
            parts,
            expected
                .map(|(part, bytes)| (part.to_owned(), bytes))
                .into()
        );
    }
}
