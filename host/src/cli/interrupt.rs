//! Ctrl-C as a flag that loops look at, so that a drive is switched off before the command leaves.

use std::sync::atomic::{AtomicBool, Ordering};

use super::{Failure, Kind};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// True once Ctrl-C was pressed or the command was told to terminate.
#[must_use]
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Takes over Ctrl-C, SIGTERM and SIGHUP. A second one ends the process at once, for the case that
/// something waits without looking at the flag.
pub(super) fn install() -> Result<(), Failure> {
    ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .map_err(|error| {
        Failure::new(
            Kind::Unexpected,
            format!("cannot handle Ctrl-C: {error}"),
            "run the command in a normal shell session",
        )
    })
}
