//! `cargo xtask trace`: the engine decides the same, bit for bit, here and on an emulated Cortex-M4.

use std::fmt::Write as _;

use windlass_firmware::exercise::{self, SEED};

use crate::board;
use crate::emulator::{self, QEMU};
use crate::error::Error;
use crate::firmware::build;
use crate::toolchain::Toolchain;

/// The program that prints the fingerprints.
const PROGRAM: &str = "windlass-trace";

/// Builds, runs both and compares.
pub(crate) fn run() -> Result<(), Error> {
    emulator::require()?;
    let toolchain = Toolchain::find()?;
    let elf = build(&toolchain, &board::find("qemu")?, PROGRAM)?;
    let mut here = String::new();
    exercise::run(SEED, |ticks, fingerprint| {
        // Writing to a string cannot fail.
        let _ = writeln!(here, "{ticks} {fingerprint:016x}");
    });
    let output = emulator::qemu(&elf)
        .output()
        .map_err(|cause| Error::Start {
            program: QEMU.to_owned(),
            cause,
            hint: "apt-get install qemu-system-arm",
        })?;
    // QEMU 7.2 writes the text of semihosting to its standard error.
    let there = [output.stdout, output.stderr].concat();
    let there = String::from_utf8_lossy(&there);
    println!(
        "ticks, fingerprint on {} and on the Cortex-M4",
        std::env::consts::ARCH
    );
    for (one, other) in here.lines().zip(there.lines()) {
        println!("{one}  {}", other.split(' ').next_back().unwrap_or(""));
    }
    if here.trim() == there.trim() {
        println!("equal");
        Ok(())
    } else {
        Err(Error::Differs)
    }
}
