//! The latest crash in the journal, beside the settings: it is known also after a loss of power.

use embedded_storage::nor_flash::NorFlash;

use super::{Change, Journal, Key};
use crate::reset::{Reset, ResetCause};

/// Why a program ended that did not end on purpose (see [`ResetCause::is_failure`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crash {
    /// Why.
    pub cause: ResetCause,
    /// What [`ResetCause`] says of it, else 0.
    pub detail: u32,
    /// Where, as [`ResetCause`] says, else 0.
    pub place: u32,
}

impl Crash {
    /// The latest crash that is known of. If this run began with one, it is written first, unless it is the one that is
    /// kept already: a program that crashes over and over in the same way does not wear the flash. That may take an
    /// erase, so that this is for the time before the drive starts.
    pub fn keep<F: NorFlash>(journal: &mut Journal, flash: &mut F, reset: &Reset) -> Option<Self> {
        let kept = journal
            .get(flash, Key::CRASH)
            .and_then(|value| Self::read(&value));
        if !reset.cause.is_failure() {
            return kept;
        }
        let crash = Self {
            cause: reset.cause,
            detail: reset.detail,
            place: reset.place,
        };
        if kept != Some(crash) {
            let change = Change {
                key: Key::CRASH,
                value: Some(&crash.to_bytes()),
            };
            // If it fails, the crash is known until the next restart.
            let _ = journal.save(flash, &change, true);
        }
        Some(crash)
    }

    const fn to_bytes(self) -> [u8; 9] {
        let [a, b, c, d] = self.detail.to_le_bytes();
        let [e, f, g, h] = self.place.to_le_bytes();
        [self.cause as u8, a, b, c, d, e, f, g, h]
    }

    fn read(bytes: &[u8]) -> Option<Self> {
        let [cause, a, b, c, d, e, f, g, h] = *bytes.first_chunk()?;
        Some(Self {
            cause: ResetCause::from_code(cause)?,
            detail: u32::from_le_bytes([a, b, c, d]),
            place: u32::from_le_bytes([e, f, g, h]),
        })
    }
}
