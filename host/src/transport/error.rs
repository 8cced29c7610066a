//! Why a bus could not be opened or stopped working.

use std::io;

/// An error of a transport. Its text names the cause, [`BusError::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The transport string makes no sense.
    #[error("bad transport \"{text}\": {reason}")]
    BadTransport {
        /// What was given.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The device, host or interface could not be opened.
    #[error("cannot open {what}: {reason}")]
    Open {
        /// Which one.
        what: String,
        /// What the system says.
        reason: String,
        /// What to do about it.
        next: String,
    },
    /// The connection broke.
    #[error("{what} failed: {source}")]
    Lost {
        /// Which one.
        what: String,
        /// What the system says.
        source: io::Error,
    },
}

impl BusError {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::BadTransport { .. } => {
                "use sim, slcan:/dev/ttyACM0@1000000, tcp:HOST:PORT or socketcan:can0".to_owned()
            }
            Self::Open { next, .. } => next.clone(),
            Self::Lost { what, .. } => {
                format!("check that {what} is still there and powered, then run the command again")
            }
        }
    }
}
