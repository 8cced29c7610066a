//! How much stack an image can need, and how much the emulated one was seen to need.

use crate::board::{self, Board};
use crate::calls::{CallGraph, Depth};
use crate::emulator;
use crate::error::Error;
use crate::firmware::{APPLICATION, BOOTLOADER, build};
use crate::image::{Image, Part};
use crate::toolchain::Toolchain;

/// What the processor pushes for an interrupt, with floating-point registers and alignment (ARMv7-M
/// Architecture Reference Manual, B1.5.7): 26 words, aligned to 8 bytes.
const EXCEPTION_FRAME: u64 = 112;
/// Tests that are run for the high-water mark.
const TESTS: [&str; 1] = ["test_firmware.Management"];

/// The deepest chains of an image.
pub(crate) struct Bound {
    /// Thread mode and one handler of each interrupt priority, lowest first.
    levels: Vec<(&'static str, Depth)>,
    /// Bytes of all of them, with what the processor pushes.
    pub(crate) total: u64,
    /// Bytes that are reserved.
    pub(crate) region: u64,
}

impl Bound {
    /// Adds up an image: thread mode, and on top of it the deepest handler of each interrupt priority. A bootloader
    /// has not all of the board's handlers.
    pub(crate) fn of(image: &Image, board: &Board, part: Part) -> Result<Self, Error> {
        let graph = CallGraph::read(image.path())?;
        let missing = |name: &str| Error::Image {
            path: image.path().to_owned(),
            what: format!("it has no function {name}"),
        };
        let mut levels = vec![(
            "thread mode",
            graph.depth("main").ok_or_else(|| missing("main"))?,
        )];
        for handlers in board.handlers {
            let mut deepest: Option<(&'static str, Depth)> = None;
            for handler in *handlers {
                let Some(depth) = graph.depth(handler) else {
                    if part == Part::Application {
                        return Err(missing(handler));
                    }
                    continue;
                };
                if deepest
                    .as_ref()
                    .is_none_or(|(_, most)| depth.bytes > most.bytes)
                {
                    deepest = Some((handler, depth));
                }
            }
            levels.extend(deepest);
        }
        let pushed = EXCEPTION_FRAME * (levels.len() as u64 - 1);
        Ok(Self {
            total: levels.iter().map(|(_, depth)| depth.bytes).sum::<u64>() + pushed,
            levels,
            region: image.symbol("_stack_start")? - image.symbol("_stack_end")?,
        })
    }

    /// An error if the stack does not suffice, or if it and the `ram` bytes of static RAM of the bootloader of a real board
    /// go beyond its budget.
    pub(crate) fn check(&self, ram: u64, board: &Board, part: Part) -> Result<(), Error> {
        let (_, budget) = part.budget(board.signed);
        let is_limited = part == Part::Bootloader && board.budgeted;
        let (what, bytes, room) = if self.total > self.region {
            ("stack", self.total, self.region)
        } else if is_limited && ram + self.total > budget {
            ("static RAM and stack", ram + self.total, budget)
        } else {
            return Ok(());
        };
        Err(Error::TooLarge {
            what: format!("{what} {bytes} of {room} bytes"),
        })
    }
}

/// Prints the static figures of a board's programs, and what was seen of the emulated one; more than the region is an
/// error. Without a name, of all boards; `signed`: of all whose bootloader has room to check signatures.
pub(crate) fn run(name: Option<&str>, signed: bool) -> Result<(), Error> {
    let toolchain = Toolchain::find()?;
    let boards = match name {
        Some(name) => vec![board::find(name)?],
        None => board::BOARDS.to_vec(),
    };
    for board in boards {
        let board = board.with_signatures(signed);
        for (program, part) in [
            (BOOTLOADER, Part::Bootloader),
            (APPLICATION, Part::Application),
        ] {
            let elf = match build(&toolchain, &board, program) {
                Err(error @ Error::NoRoomForSignatures { .. }) if name.is_none() => {
                    println!("{error}");
                    break;
                }
                built => built?,
            };
            let image = Image::read(&elf)?;
            let bound = Bound::of(&image, &board, part)?;
            let checks = if signed && part == Part::Bootloader {
                ", which checks signatures"
            } else {
                ""
            };
            println!("{} {program}{checks}", board.name);
            for (level, depth) in &bound.levels {
                show(level, depth);
            }
            println!(
                "  static worst case {} bytes (with {EXCEPTION_FRAME} pushed for each interrupt) of {}",
                bound.total, bound.region
            );
            if part == Part::Bootloader {
                println!(
                    "  static RAM        {} bytes, with the stack {}",
                    image.ram(),
                    image.ram() + bound.total
                );
            }
            bound.check(image.ram(), &board, part)?;
            if part == Part::Application && board.name == board::EMULATED {
                println!(
                    "  high-water mark   {} bytes",
                    high_water(&toolchain, &board, &image)?
                );
            }
        }
    }
    Ok(())
}

/// The most that the emulator's tests have needed.
fn high_water(toolchain: &Toolchain, board: &Board, image: &Image) -> Result<f64, Error> {
    let figures = emulator::test_image(toolchain, board, image, &TESTS.map(str::to_owned))?;
    Ok(figures.most("stack"))
}

fn show(name: &str, depth: &Depth) {
    println!("  {name}: {} bytes", depth.bytes);
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn static_ram_and_stack_of_a_bootloader_beyond_6_kib_fail_the_build() {
        let judge_with = |signed, name, part, ram, total| {
            let levels = Vec::new();
            let region = 12 * 1024;
            let bound = Bound {
                levels,
                total,
                region,
            };
            let board = board::find(name).unwrap().with_signatures(signed);
            bound.check(ram, &board, part).is_ok()
        };
        let judge = |name, part, ram, total| judge_with(false, name, part, ram, total);
        assert!(judge(board::DEFAULT, Part::Bootloader, 4148, 1996));
        assert!(!judge(board::DEFAULT, Part::Bootloader, 4148, 1997));
        // One that checks signatures may take 9.
        assert!(judge_with(
            true,
            board::DEFAULT,
            Part::Bootloader,
            4148,
            5068
        ));
        assert!(!judge_with(
            true,
            board::DEFAULT,
            Part::Bootloader,
            4148,
            5069
        ));
        // An application's stack is beside its static RAM, and the emulated board holds a serial line's buffers.
        assert!(judge(board::DEFAULT, Part::Application, 7300, 12 * 1024));
        assert!(judge(board::EMULATED, Part::Bootloader, 4148, 1997));
        assert!(!judge(board::EMULATED, Part::Bootloader, 0, 12 * 1024 + 1));
    }
}
