//! Commands of the Windlass workspace, run as `cargo xtask COMMAND`.

mod board;
mod calls;
mod emulator;
mod error;
mod firmware;
mod image;
mod log;
mod measure;
mod pack;
mod panics;
mod sources;
mod stack;
mod toolchain;
mod trace;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Commands of the Windlass workspace")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Builds bootloader and application of one board and shows what they take up
    Firmware {
        /// Board to build for
        #[arg(long, default_value = board::DEFAULT)]
        board: String,
        /// The bootloader checks signatures, once a key is installed
        #[arg(long)]
        signed: bool,
    },
    /// Builds bootloader and application of one board and flashes both with probe-rs
    Flash {
        /// Board to build for
        #[arg(long, default_value = board::DEFAULT)]
        board: String,
        /// The bootloader checks signatures, once a key is installed
        #[arg(long)]
        signed: bool,
    },
    /// Counts the instructions of the core's hot paths in QEMU, and the jitter of the tick under a flood of frames
    Measure,
    /// Compares a million ticks of the engine here with those on an emulated Cortex-M4
    Trace,
    /// Proves by linking that no function of the core can panic
    NoPanic,
    /// Prints how much stack bootloader and application can need and, of the board `qemu`, were seen to need
    Stack {
        /// Board to look at; all by default
        #[arg(long)]
        board: Option<String>,
        /// With bootloaders that check signatures; without a board, of all boards that have room for one
        #[arg(long)]
        signed: bool,
    },
    /// Prints which part of the sources the machine code of a board's bootloader comes from
    Sources {
        /// Board to build for
        #[arg(long, default_value = board::DEFAULT)]
        board: String,
    },
    /// Decodes the log of an image: raw frames on standard input become lines
    Log {
        /// The linked file that is running
        elf: PathBuf,
    },
    /// Runs the firmware in QEMU and drives it with python-can
    QemuTest {
        /// Tests to run, as unittest names them; all by default
        names: Vec<String>,
    },
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Firmware { board, signed } => firmware::run(&board, signed).map(|_| ()),
        Command::Flash { board, signed } => firmware::flash(&board, signed),
        Command::Log { elf } => log::run(&elf),
        Command::Measure => measure::run(),
        Command::NoPanic => panics::run(),
        Command::Sources { board } => sources::run(&board),
        Command::Stack { board, signed } => stack::run(board.as_deref(), signed),
        Command::Trace => trace::run(),
        Command::QemuTest { names } => emulator::test(&names),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The workspace's folder.
fn root() -> PathBuf {
    let mut path = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    path.pop();
    path
}
