//! `cargo xtask measure`: instructions of the core's hot paths on an emulated Cortex-M4, and the jitter of the tick.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::board;
use crate::emulator::{self, QEMU};
use crate::error::Error;
use crate::firmware::{APPLICATION, SIGNATURES, build, checked, profile};
use crate::image::Image;
use crate::toolchain::Toolchain;

/// The program that calls what is measured.
const PROGRAM: &str = "windlass-measure";

/// Floods the firmware with frames and measures the jitter of its tick.
const JITTER_TEST: &str = "test_firmware.Flood";

/// Something that is measured: its function's symbol, what it is, and its budget for mean and worst.
struct Subject {
    symbol: &'static str,
    about: &'static str,
    budget: Option<(u64, u64)>,
    yardstick: &'static str,
}

/// What the bootloader does when it commits a signed image.
const SIGNATURE_SUBJECTS: [Subject; 2] = [
    Subject {
        symbol: "measured_signature",
        about: "one signature",
        budget: None,
        yardstick: "",
    },
    Subject {
        symbol: "measured_digest",
        about: "digest of 31 pages",
        budget: None,
        yardstick: "",
    },
];

const SUBJECTS: [Subject; 14] = [
    Subject {
        symbol: "measured_pidf",
        about: "one PIDF step, all gains",
        budget: Some((50, 50)),
        yardstick: "CMSIS-DSP arm_pid_q31 20, moteus 84, VESC 108-129",
    },
    Subject {
        symbol: "measured_tick",
        about: "one tick, every mode and flag",
        budget: Some((180, 250)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_loop_tick",
        about: "one tick of a position loop, no fault",
        budget: Some((180, 250)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_throttle_law",
        about: "one step of the Talon's law, all gains",
        budget: Some((50, 50)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_throttle_tick",
        about: "one tick as a Talon, every mode, sensor and flag",
        budget: Some((180, 250)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_throttle_loop_tick",
        about: "one tick of a position loop as a Talon",
        budget: Some((180, 250)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_talon_decode",
        about: "Talon control frame, decode",
        budget: Some((40, 40)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_talon_foreign",
        about: "foreign frame, refused by the Talon dialect",
        budget: Some((12, 12)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_control_decode",
        about: "control frame, decode",
        budget: Some((40, 40)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_status_encode",
        about: "general status, encode",
        budget: Some((40, 40)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_foreign_decode",
        about: "foreign frame, refused by the dialect",
        budget: Some((12, 12)),
        yardstick: "",
    },
    Subject {
        symbol: "measured_node_control",
        about: "control frame, whole node",
        budget: None,
        yardstick: "",
    },
    Subject {
        symbol: "measured_node_foreign",
        about: "foreign frame, whole node",
        budget: None,
        yardstick: "",
    },
    Subject {
        symbol: "measured_node_idle",
        about: "thread mode once a tick, whole node",
        budget: None,
        yardstick: "",
    },
];

/// One line of the plugin's output.
#[derive(Debug, PartialEq)]
struct Count {
    name: String,
    calls: u64,
    least: u64,
    mean: f64,
    most: u64,
}

/// Builds, runs and prints.
pub(crate) fn run() -> Result<(), Error> {
    emulator::require()?;
    let toolchain = Toolchain::find()?;
    let plugin = build_plugin()?;
    count(&toolchain, &plugin, PROGRAM, &SUBJECTS)?;
    count(&toolchain, &plugin, SIGNATURES, &SIGNATURE_SUBJECTS)?;
    jitter(&toolchain)
}

/// Builds a program, counts the instructions of its subjects and prints them.
fn count(
    toolchain: &Toolchain,
    plugin: &Path,
    program: &str,
    subjects: &[Subject],
) -> Result<(), Error> {
    let elf = build(toolchain, &board::find("qemu")?, program)?;
    let image = Image::read(&elf)?;
    let counts = plugin.with_extension("txt");
    let mut argument = format!("{},out={}", plugin.display(), counts.display());
    for subject in subjects {
        let address = image.symbol(subject.symbol)?;
        argument.push_str(&format!(",watch={}:{address:#x}", subject.symbol));
    }
    let mut qemu = emulator::qemu(&elf);
    qemu.arg("-plugin").arg(argument);
    checked(QEMU, &mut qemu, "apt-get install qemu-system-arm")?;
    let text = fs::read_to_string(&counts).map_err(|cause| Error::File {
        path: counts.clone(),
        cause,
    })?;
    let counts: Vec<Count> = text.lines().filter_map(parse).collect();
    println!(
        "\ninstructions on a Cortex-M4, profile `{}`, {toolchain}\n",
        profile(program)
    );
    println!(
        "{:<38} {:>7} {:>5} {:>8} {:>5}  budget",
        "", "calls", "least", "mean", "most"
    );
    for subject in subjects {
        let count = counts.iter().find(|count| count.name == subject.symbol);
        let Some(count) = count.filter(|count| count.calls > 0) else {
            return Err(Error::Image {
                path: elf,
                what: format!("{} was never called", subject.symbol),
            });
        };
        println!("{}", line(subject, count));
    }
    Ok(())
}

/// Prints how punctual the tick of the whole firmware is while frames come without end.
fn jitter(toolchain: &Toolchain) -> Result<(), Error> {
    let board = board::find(board::EMULATED)?;
    let image = Image::read(&build(toolchain, &board, APPLICATION)?)?;
    let figures = emulator::test_image(toolchain, &board, &image, &[JITTER_TEST.to_owned()])?;
    println!(
        "\nstart of the tick under a flood of frames: {:.2} us between the earliest and the latest",
        figures.most("jitter")
    );
    Ok(())
}

fn line(subject: &Subject, count: &Count) -> String {
    let budget = match subject.budget {
        None => String::new(),
        Some((mean, most)) => {
            let kept = count.mean <= mean as f64 && count.most <= most;
            let verdict = if kept { "kept" } else { "exceeded" };
            format!("{mean}/{most} {verdict} {}", subject.yardstick)
        }
    };
    let text = format!(
        "{:<38} {:>7} {:>5} {:>8.1} {:>5}  {budget}",
        subject.about, count.calls, count.least, count.mean, count.most
    );
    text.trim_end().to_owned()
}

fn parse(line: &str) -> Option<Count> {
    let mut words = line.split(' ');
    Some(Count {
        name: words.next()?.to_owned(),
        calls: words.next()?.parse().ok()?,
        least: words.next()?.parse().ok()?,
        mean: words.next()?.parse().ok()?,
        most: words.next()?.parse().ok()?,
    })
}

/// Compiles the counting plugin.
fn build_plugin() -> Result<PathBuf, Error> {
    let folder = crate::root().join("target/firmware");
    let plugin = folder.join("count.so");
    let mut compiler = Command::new("cc");
    compiler
        .args([
            "-O2",
            "-Wall",
            "-Wextra",
            "-shared",
            "-fPIC",
            "-fvisibility=hidden",
            "-o",
        ])
        .arg(&plugin)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("plugin/count.c"));
    checked(
        "cc",
        &mut compiler,
        "install a C compiler: apt-get install gcc libc6-dev",
    )?;
    Ok(plugin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_plugin_is_read() {
        let count = parse("measured_tick 100 90 120.50 200 7").expect("a count");
        assert_eq!((count.calls, count.least, count.most), (100, 90, 200));
        let subject = &SUBJECTS[1];
        assert!(line(subject, &count).contains("180/250 kept"));
        let slow = Count { most: 251, ..count };
        assert!(line(subject, &slow).contains("exceeded"));
        assert_eq!(parse("measured_tick 100"), None);
    }
}
