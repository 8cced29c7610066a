//! What can go wrong between the client and a device.

use super::{Address, Selector};
use crate::transport::BusError;

/// An error of the client. Its text names the cause, [`Error::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// No device answered the enumeration.
    #[error("no device answered on this bus")]
    NoDevice,
    /// No device matches the selector.
    #[error("there is no device {selector} on this bus")]
    NotFound {
        /// What was looked for.
        selector: Selector,
        /// Who is there.
        present: Vec<Address>,
    },
    /// Several devices match the selector.
    #[error("{} devices match {selector}", candidates.len())]
    Ambiguous {
        /// What was looked for.
        selector: Selector,
        /// Who matches.
        candidates: Vec<Address>,
    },
    /// A device that was there before does not answer.
    #[error("device {address} did not answer {request}")]
    NoAnswer {
        /// Who was asked.
        address: Address,
        /// What was asked, by its name in the guide.
        request: String,
    },
    /// The device has another session now: it restarted or lost the bus, and ignores the old session.
    #[error("device {address} has restarted or lost the bus: its session is now {session:#06x}")]
    WrongSession {
        /// Who was asked.
        address: Address,
        /// The session it has now.
        session: u16,
    },
    /// The device refused.
    #[error("device {address} refused {request}: {code}")]
    Refused {
        /// Who was asked.
        address: Address,
        /// What was asked, by its name in the guide.
        request: String,
        /// The device's answer, by its name in the guide.
        code: String,
    },
    /// The answer makes no sense.
    #[error("device {address} answered {request} with data that makes no sense: {reason}")]
    BadAnswer {
        /// Who was asked.
        address: Address,
        /// What was asked.
        request: String,
        /// What is wrong with the answer.
        reason: String,
    },
    /// The value cannot be sent.
    #[error(transparent)]
    Value(#[from] ValueError),
}

/// A value that the protocol cannot carry or the device does not allow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ValueError(String);

impl ValueError {
    /// An error with a text that names the value and what is allowed.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }
}

impl Error {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::Bus(error) => error.next_step(),
            Self::NoDevice => "check power, wiring, both terminating resistors and the bit rate (1 Mbit/s)".to_owned(),
            Self::NotFound { present, .. } => format!("use one of {}", list(present)),
            Self::Ambiguous { candidates, .. } => format!(
                "name one by its session, {}; then give it a number of its own with `windlass id set`",
                list(candidates)
            ),
            Self::NoAnswer { .. } => {
                "look for it with `windlass scan`; on a busy or slow bus give more time with --timeout".to_owned()
            }
            Self::WrongSession { address, session } => {
                let number = address.number;
                format!("run the command again; by session the device is now {number}@{session:#06x}")
            }
            Self::Refused { code, .. } => refusal_advice(code).to_owned(),
            Self::BadAnswer { .. } => {
                "run the command again; if it stays, the device's firmware is not compatible".to_owned()
            }
            Self::Value(_) => "give a value within the range".to_owned(),
        }
    }
}

fn list(addresses: &[Address]) -> String {
    let names: Vec<String> = addresses.iter().map(Address::to_string).collect();
    names.join(", ")
}

fn refusal_advice(code: &str) -> &'static str {
    match code {
        "percBadParameter" => {
            "the device does not know this parameter; `windlass param get` lists those it knows"
        }
        "percBadValue" => {
            "the value is outside the device's range; `windlass param get` shows the present one"
        }
        "cercNotSupported" => {
            "the running image does not know this command; see which one runs with `windlass info`"
        }
        "cercBadParameter" => "the value is outside the device's range",
        "cercDataRcvMore" | "cercCrcMismatch" => {
            "the transfer was disturbed: run the command again"
        }
        "cercKeyRefused" => {
            "the device holds another key: give the signing key that belongs to it with --replaces"
        }
        "cercFlashWriteFailed" => {
            "the device could not store it: see `windlass info`, settings; if they are of a newer format, flash that firmware again"
        }
        "cercSaveWaits" => {
            "the change is in force; stop the motor and it is written a second later (`windlass info`, settings)"
        }
        "cercDriveRunning" => "stop the motor and run the command again",
        _ => "look at the device with `windlass info` and `windlass faults`",
    }
}
