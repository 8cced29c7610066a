//! What the management channel makes of frames, and what it answers with.

use super::vendor::{Descriptor, PinTest};
use crate::dialect::{Bad, Request as ParameterQuery};
use crate::frame::Frame;

/// A request of the host, checked, to be executed by the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Enumerate.
    Enumerate,
    /// Read or write a parameter.
    Parameter(ParameterQuery),
    /// Store the device number, one that the [`Identity`](super::Identity) allows.
    SetNumber(u8),
    /// Store a descriptor: [`Management::text`](super::Management::text).
    SetDescriptor(Descriptor),
    /// Put the settings back to their defaults; `all`: device number and strings as well.
    FactoryReset {
        /// Device number and every string too, not only parameters, faults and the device's name.
        all: bool,
    },
    /// Show the identify pattern.
    Identify,
    /// Send the descriptors.
    GetDescriptors,
    /// Send the firmware versions.
    GetVersions,
    /// Send the flash sequence number.
    GetSequence,
    /// Restart into the bootloader.
    EnterBootloader,
    /// Restart.
    SoftReset,
    /// Test the expansion header.
    PinTest(PinTest),
    /// Erase and write a page: image type and page number as they came.
    WritePage {
        /// `PARAM1`.
        image: u16,
        /// `PARAM2`.
        page: u16,
    },
    /// Bytes of the transfer that [`Management::expect_data`](super::Management::expect_data) asked for.
    Data(Chunk),
    /// Tell which pages of an update are stored.
    GetPageCrcs,
    /// Put the fallback image back.
    RestoreFallback,
    /// Send the state of the slots.
    GetBootStatus,
    /// Install a key that comes as so many bytes.
    InstallKey(u16),
}

/// Bytes of a transfer, as one frame brought them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Place of the first byte in the transfer.
    pub offset: usize,
    /// The frame.
    pub frame: Frame,
    /// These are the last bytes.
    pub is_last: bool,
}

/// What a frame turned out to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoded {
    /// Not for the management channel.
    NotMine,
    /// Handled, nothing to execute.
    Done,
    /// To be executed.
    Request(Request),
    /// A frame for this device that changes nothing.
    Bad(Bad),
}

/// Which answer of the management channel a transmission carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// First enumeration answer: the second may follow once it has been sent.
    Enumerate0,
    /// Any other of the management channel.
    Other,
    /// None of the management channel's: a frame of the dialect.
    Dialect,
}
