//! Why an update did not end well.

use windlass_core::boot::status::Reason;
use windlass_core::management::vendor::CommandCode;

use crate::client::{self, Address, Version};
use crate::transport::BusError;

/// An error of an update. Its text names the cause, [`FlashError::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// Talking to the device failed.
    #[error(transparent)]
    Client(#[from] client::Error),
    /// Made for another product.
    #[error(
        "the image is for product {image:#010x}, device {address} is {device:#010x}; nothing was changed"
    )]
    WrongProduct {
        /// Which device.
        address: Address,
        /// Product of the image.
        image: u32,
        /// Product of the device.
        device: u32,
    },
    /// Made for another hardware.
    #[error("the image is for {image}, device {address} is {device}; nothing was changed")]
    WrongHardware {
        /// Which device.
        address: Address,
        /// Hardware of the image.
        image: String,
        /// Hardware of the device.
        device: String,
    },
    /// Older than the device accepts.
    #[error(
        "the image has the anti-rollback counter {image}, device {address} accepts {device} and up; nothing was changed"
    )]
    RollbackRefused {
        /// Which device.
        address: Address,
        /// Counter of the image.
        image: u32,
        /// Smallest counter that is accepted.
        device: u32,
    },
    /// The device wants a signature.
    #[error(
        "device {0} accepts signed images only, and this one is not signed; nothing was changed"
    )]
    Unsigned(Address),
    /// The motor is being driven.
    #[error("device {0} is driving its motor; nothing was changed")]
    Driving(Address),
    /// The device does not know the commands of this project's bootloader.
    #[error("device {0} does not tell what hardware it is")]
    UnknownHardware(Address),
    /// The device refused a page.
    #[error("device {address} refused page {page}: {}", code_text(*.code))]
    PageRefused {
        /// Which device.
        address: Address,
        /// Which page.
        page: u8,
        /// The device's result code.
        code: u16,
    },
    /// All pages were sent, and the device says that some are missing or different, again and again.
    #[error("device {0} does not store what it is sent")]
    NotStored(Address),
    /// There is nothing to put back.
    #[error("device {0} has no fallback image")]
    NoFallback(Address),
    /// Its bootloader takes no keys.
    #[error(
        "the bootloader of device {0} checks no signatures and takes no key; nothing was changed"
    )]
    NoSignatures(Address),
    /// The device has restarted and its bootloader runs.
    #[error("device {address} did not start the new application: {}", reason_text(*.reason))]
    NotStarted {
        /// Which device.
        address: Address,
        /// What the bootloader says.
        reason: Option<Reason>,
    },
    /// Another version runs.
    #[error("device {address} runs version {found} instead of {wanted}")]
    WrongVersion {
        /// Which device.
        address: Address,
        /// The version that answers.
        found: Version,
        /// The version of the image.
        wanted: Version,
    },
    /// The device was lost and did not come back.
    #[error("device {address} was lost and did not come back: {cause}")]
    Lost {
        /// Which device.
        address: Address,
        /// What happened first.
        cause: String,
    },
    /// Ended by Ctrl-C.
    #[error("interrupted: device {address} waits in its bootloader{}", stored_text(*.stored, *.of))]
    Cancelled {
        /// Which device.
        address: Address,
        /// Pages of the image that the device has.
        stored: usize,
        /// Pages of the image.
        of: usize,
    },
    /// Ended by Ctrl-C before anything was changed.
    #[error("interrupted: device {0} has what it had before")]
    CancelledEarly(Address),
}

fn code_text(code: u16) -> String {
    match CommandCode::from_code(code as u8) {
        Some(known) => known.name().to_owned(),
        None => format!("unknown code {code:#06x}"),
    }
}

fn stored_text(stored: usize, of: usize) -> String {
    match of {
        0 => String::new(),
        _ => format!(" with {stored} of {of} pages"),
    }
}

fn reason_text(reason: Option<Reason>) -> &'static str {
    let row = Reason::TABLE.iter().find(|row| Some(row.0) == reason);
    row.map_or("it does not tell why", |row| row.1)
}

impl From<BusError> for FlashError {
    fn from(error: BusError) -> Self {
        Self::Client(error.into())
    }
}

impl FlashError {
    /// True if the device may just be unreachable for a while.
    pub(super) const fn is_silence(&self) -> bool {
        matches!(
            self,
            Self::Client(
                client::Error::NoAnswer { .. }
                    | client::Error::WrongSession { .. }
                    | client::Error::NoDevice
                    | client::Error::BadAnswer { .. }
            )
        )
    }

    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> String {
        match self {
            Self::Client(error) => error.next_step(),
            Self::WrongProduct { .. } | Self::WrongHardware { .. } => {
                "build or get the image for this device; `windlass image inspect FILE` shows what one is for".to_owned()
            }
            Self::RollbackRefused { .. } => {
                "use an image with a higher counter; the device refuses older ones for good".to_owned()
            }
            Self::Unsigned(_) => {
                "sign it with `windlass image sign FILE --key NAME.key`, using the key that is installed in the device".to_owned()
            }
            Self::Driving(_) => "stop the program that drives it, then run the command again".to_owned(),
            Self::UnknownHardware(_) => {
                "check that it is a Windlass controller; --force leaves the check to the device".to_owned()
            }
            Self::PageRefused { code, .. } => refusal_advice(*code).to_owned(),
            Self::NotStored(_) => {
                "run the command again with --force; if it stays, replace the device".to_owned()
            }
            Self::NoSignatures(_) => {
                "give it a bootloader that does, with a debug probe: `cargo xtask flash --signed`".to_owned()
            }
            Self::NoFallback(_) => "flash an older file instead: windlass flash FILE DEVICE".to_owned(),
            Self::NotStarted { .. } => {
                "flash another version; the device waits in its bootloader".to_owned()
            }
            Self::WrongVersion { .. } => {
                "run the command again; `windlass info` shows what runs".to_owned()
            }
            Self::Lost { .. } => {
                "check power and wiring, then run the same command again: it goes on where it stopped".to_owned()
            }
            Self::Cancelled { .. } => {
                "run the same command again: it sends only the pages that are missing".to_owned()
            }
            Self::CancelledEarly(_) => "run the command again".to_owned(),
        }
    }
}

fn refusal_advice(code: u16) -> &'static str {
    match CommandCode::from_code(code as u8) {
        Some(CommandCode::NotSupported) => {
            "the running image takes no pages: this controller cannot be updated over CAN"
        }
        Some(CommandCode::WrongProduct | CommandCode::WrongHardware) => {
            "build or get the image for this device; it still has what it had before"
        }
        Some(CommandCode::RollbackRefused) => {
            "use an image with a higher anti-rollback counter; the device still has what it had before"
        }
        Some(CommandCode::BadSignature) => {
            "sign the image with the key that is installed in the device"
        }
        Some(CommandCode::FlashWriteFailed) => {
            "run the command again; if it stays, the device's flash is worn out"
        }
        Some(CommandCode::NoImage) => {
            "pack the file again with `windlass image pack`, using this version of windlass"
        }
        _ => "run the command again",
    }
}
