//! The answer to an enumeration request: when it comes, and what becomes of it.

use crate::time::{Duration, Instant, TICK};

/// Unit of the enumeration delay (docs/dmc60c.md).
const DELAY_UNIT: Duration = TICK;

/// Progress of an enumeration. The number is kept so that both answers carry the same one.
#[derive(Clone, Copy, Debug)]
pub(super) enum Enumeration {
    Idle,
    /// `again`: an attempt has been destroyed already.
    Waiting {
        due: Instant,
        again: bool,
    },
    FirstOnTheWay {
        number: u8,
        again: bool,
    },
    SecondReady {
        number: u8,
    },
}

impl Enumeration {
    /// A request has come. A request during a pending answer is dropped.
    ///
    /// Numbered devices wait twice their number, others seven bits of their session id, in units of
    /// 500 µs; 0 becomes 1.
    pub(super) fn request(&mut self, now: Instant, own: u8, session: u16) {
        if !matches!(self, Self::Idle) {
            return;
        }
        let units = match own {
            0 => session_units(session),
            number => 2 * u32::from(number),
        };
        *self = Self::Waiting {
            due: now + delay(units),
            again: false,
        };
    }

    /// The first answer has been sent: the second follows.
    pub(super) fn first_sent(&mut self) {
        if let Self::FirstOnTheWay { number, .. } = *self {
            *self = Self::SecondReady { number };
        }
    }

    /// The first answer was destroyed, and the session id is now `session`: it comes once more at most,
    /// after the delay of that session.
    pub(super) fn first_destroyed(&mut self, now: Instant, session: u16) {
        if let Self::FirstOnTheWay { again, .. } = *self {
            *self = if again {
                Self::Idle
            } else {
                Self::Waiting {
                    due: now + delay(session_units(session)),
                    again: true,
                }
            };
        }
    }

    /// When the next answer is to be sent.
    pub(super) const fn due(&self) -> Option<Instant> {
        match *self {
            Self::Waiting { due, .. } => Some(due),
            Self::SecondReady { .. } => Some(Instant::ZERO),
            Self::Idle | Self::FirstOnTheWay { .. } => None,
        }
    }
}

/// Delay of a device without a number: seven bits of its session id.
fn session_units(session: u16) -> u32 {
    u32::from(session & 0x7F)
}

/// An enumeration delay, at least one unit.
fn delay(units: u32) -> Duration {
    Duration::from_micros(u64::from(units.max(1)) * DELAY_UNIT.as_micros())
}
