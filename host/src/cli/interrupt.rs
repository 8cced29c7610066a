//! Ctrl-C as a flag that loops look at, so that a drive is switched off before the command leaves.

use std::sync::atomic::{AtomicBool, Ordering};

use super::{Failure, Kind, Outcome};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// True once Ctrl-C was pressed or the command was told to terminate.
#[must_use]
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Takes over Ctrl-C, SIGTERM and SIGHUP. With `gracefully` the first one only raises the flag, for a
/// verb that looks at it; everything else ends the process at once.
pub(super) fn install(gracefully: bool) -> Result<(), Failure> {
    ctrlc::set_handler(move || {
        let again = INTERRUPTED.swap(true, Ordering::Relaxed);
        if again || !gracefully {
            std::process::exit(i32::from(Outcome::Interrupted.code()));
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
