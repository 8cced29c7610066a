//! How a verb ends: exit codes, and errors that name their cause and the next step.

use std::process::ExitCode;

use crate::client::talon::TalonError;
use crate::client::{self, ValueError};
use crate::remark::remark;
use crate::transport::BusError;

/// What went wrong, by the exit code it leads to (`docs/command.md`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing below fits.
    Unexpected = 1,
    /// Unknown verb or option, malformed value.
    Usage = 2,
    /// The transport could not be opened, or the bus failed.
    Bus = 3,
    /// No such device, or the selector matches several.
    NoDevice = 4,
    /// The device did not answer.
    NoAnswer = 5,
    /// The device refused, or a value is out of range.
    Refused = 6,
    /// A firmware or key file cannot be used.
    File = 8,
    /// Ended by Ctrl-C with something left to do.
    Interrupted = 130,
}

impl Kind {
    /// The kind's name in the JSON form of an error.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unexpected => "unexpected",
            Self::Usage => "usage",
            Self::Bus => "bus",
            Self::NoDevice => "no-device",
            Self::NoAnswer => "no-answer",
            Self::Refused => "refused",
            Self::File => "file",
            Self::Interrupted => "interrupted",
        }
    }
}

/// An error as the user sees it: what happened, and what to do next.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// Decides the exit code.
    pub kind: Kind,
    /// What happened, one line without a full stop.
    pub message: String,
    /// What to do next, one line.
    pub next: String,
}

impl Failure {
    /// A failure of `kind`.
    #[must_use]
    pub fn new(kind: Kind, message: impl Into<String>, next: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            next: next.into(),
        }
    }

    /// The failure as JSON.
    #[must_use]
    pub fn describe(&self) -> serde_json::Value {
        serde_json::json!({
            "kind": self.kind.name(),
            "message": self.message,
            "next": self.next,
            "code": self.kind as u8,
        })
    }

    /// Prints the failure for people, on standard error.
    pub fn print(&self) {
        remark(format_args!("error: {}\nnext: {}", self.message, self.next));
    }
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        let kind = match error {
            BusError::BadTransport { .. } => Kind::Usage,
            BusError::Open { .. } | BusError::Lost { .. } => Kind::Bus,
        };
        Self::new(kind, error.to_string(), error.next_step())
    }
}

impl From<client::Error> for Failure {
    fn from(error: client::Error) -> Self {
        use client::Error;
        let kind = match error {
            Error::Bus(error) => return error.into(),
            Error::NoDevice | Error::NotFound { .. } | Error::Ambiguous { .. } => Kind::NoDevice,
            Error::NoAnswer { .. } | Error::WrongSession { .. } => Kind::NoAnswer,
            Error::Refused { .. } | Error::Value(_) => Kind::Refused,
            Error::BadAnswer { .. } => Kind::Unexpected,
        };
        Self::new(kind, error.to_string(), error.next_step())
    }
}

impl From<TalonError> for Failure {
    fn from(error: TalonError) -> Self {
        let kind = match error {
            TalonError::TxFailed(error) => return error.into(),
            TalonError::InvalidParameter(_) => Kind::Refused,
            TalonError::RxTimeout { .. } | TalonError::NotUpdated { .. } => Kind::NoAnswer,
        };
        Self::new(kind, error.to_string(), error.next_step())
    }
}

impl From<ValueError> for Failure {
    fn from(error: ValueError) -> Self {
        client::Error::from(error).into()
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::new(
            Kind::Unexpected,
            format!("input or output failed: {error}"),
            "check that the place the output goes to is still open and not full",
        )
    }
}

/// How a verb that did its work ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything was done.
    Done,
    /// A self-test failed or a device reports a fault; the report has been printed.
    FaultReported,
    /// Something failed for some of several devices; that has been printed.
    Told(Kind),
    /// Ended by Ctrl-C, after leaving the devices in a safe state.
    Interrupted,
}

impl Outcome {
    /// The exit code of this end.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::FaultReported => 7,
            Self::Told(kind) => kind as u8,
            Self::Interrupted => 130,
        }
    }
}

/// Prints an error where it belongs (one `error:` and one `next:` line on standard error, or a JSON
/// document on standard output) and gives the exit code.
pub(super) fn report(failure: &Failure, json: bool) -> ExitCode {
    if json {
        let document = serde_json::json!({"error": failure.describe()});
        // A closed standard output leaves only the exit code to tell the error.
        let _ = super::output::json(&document);
    } else {
        failure.print();
    }
    ExitCode::from(failure.kind as u8)
}
