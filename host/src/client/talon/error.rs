//! What can go wrong between a Talon and its host, with the numbers of the published clients.

use crate::client::ValueError;
use crate::transport::BusError;

/// An error of the Talon client. Its text names the cause, [`TalonError::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum TalonError {
    /// The newest frame with this value is older than 200 ms, or none ever came (code 1). The manual's
    /// LabVIEW clients call the latter −44087 (manual 16.8).
    #[error("Talon {number} is not responding: {what} is {}", age_text(*age_ms))]
    RxTimeout {
        /// Device number.
        number: u8,
        /// What was wanted.
        what: &'static str,
        /// Age of the newest value in milliseconds; none if there was never one.
        age_ms: Option<u64>,
    },
    /// The value cannot be sent (code 3).
    #[error(transparent)]
    InvalidParameter(ValueError),
    /// The bus failed (code 5).
    #[error(transparent)]
    TxFailed(#[from] BusError),
    /// A parameter's answer did not come in time (code 6).
    #[error("Talon {number} did not answer for parameter {parameter}")]
    NotUpdated {
        /// Device number.
        number: u8,
        /// Number of the parameter.
        parameter: u8,
    },
}

fn age_text(age_ms: Option<u64>) -> String {
    match age_ms {
        Some(age) => format!("{age} ms old"),
        None => "missing, no such frame was ever received".to_owned(),
    }
}

impl TalonError {
    /// A value that cannot be sent.
    pub(super) fn invalid(text: impl Into<String>) -> Self {
        Self::InvalidParameter(ValueError::new(text))
    }

    /// The published clients' number for this error; 0 would be "no error", 4 never arises here.
    #[must_use]
    pub const fn code(&self) -> i32 {
        match self {
            Self::RxTimeout { .. } => 1,
            Self::InvalidParameter(_) => 3,
            Self::TxFailed(_) => 5,
            Self::NotUpdated { .. } => 6,
        }
    }

    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::RxTimeout { .. } => {
                "check that a Talon with this number is on the bus and powered: `windlass scan`"
                    .to_owned()
            }
            Self::InvalidParameter(_) => "give a value within the range".to_owned(),
            Self::TxFailed(error) => error.next_step(),
            Self::NotUpdated { .. } => {
                "check the device with `windlass scan`; on a busy or slow bus allow more time for answers"
                    .to_owned()
            }
        }
    }
}
