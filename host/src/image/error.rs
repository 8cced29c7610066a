//! Why a firmware file cannot be used.

use std::io;
use std::path::PathBuf;

use windlass_core::boot::image::{ImageError, MalformedHeader, MalformedInfo, PackError};

use super::container::ContainerError;
use super::crf::CrfError;
use super::elf::ElfError;
use super::hex::HexError;

/// Why a firmware file cannot be used. The text names the cause, [`FileError::next_step`] the way out.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file is longer than any of its format.
    #[error("the file has more than {0} bytes, too many for a firmware file of this format")]
    TooLong(usize),
    /// The file is empty.
    #[error("the file is empty")]
    Empty,
    /// Neither its first bytes nor its name tell what it is.
    #[error("this is no firmware file of a known format")]
    UnknownFormat,
    /// Damaged HEX.
    #[error(transparent)]
    Hex(#[from] HexError),
    /// Damaged or foreign ELF.
    #[error(transparent)]
    Elf(#[from] ElfError),
    /// Damaged container.
    #[error(transparent)]
    Container(#[from] ContainerError),
    /// Damaged `.crf`.
    #[error(transparent)]
    Crf(#[from] CrfError),
    /// No information block anywhere.
    #[error("the file holds no Windlass application: there is no information block")]
    NoApplication,
    /// Several information blocks.
    #[error("the file holds more than one application, at {0:#010x} and {1:#010x}")]
    Several(u32, u32),
    /// Data behind the end of the slot.
    #[error(
        "the application does not fit: it has data at {address:#010x}, its slot ends before {end:#010x}"
    )]
    BeyondSlot {
        /// The first byte that does not fit.
        address: u32,
        /// End of the slot.
        end: u32,
    },
    /// Pages that the hardware has no room for.
    #[error("the image has pages that its hardware has no room for (bitmap {0:#010x})")]
    TooLarge(u32),
    /// The information block is damaged.
    #[error("the information block of the application {}", malformed_info(*.0))]
    Info(MalformedInfo),
    /// An unknown hardware id.
    #[error(
        "the application is for hardware {0:#010x}, which this version of windlass does not know"
    )]
    Hardware(u32),
    /// The version that stands for "none".
    #[error("the application has the version 255.255, which stands for \"none\"")]
    Version,
    /// The header is damaged.
    #[error("the image's header {}", malformed_header(*.0))]
    Header(MalformedHeader),
    /// Header and information block, or container and header, disagree.
    #[error("{0}")]
    Disagree(&'static str),
    /// The image's CRC is wrong.
    #[error("the image is damaged: the CRC over its pages is wrong")]
    Crc,
    /// A file without header, where one is needed.
    #[error(
        "the file has no seal: it comes straight from a linker, and nothing tells whether it is whole"
    )]
    NotSealed,
}

const fn malformed_info(error: MalformedInfo) -> &'static str {
    match error {
        MalformedInfo::Magic => "is missing",
        MalformedInfo::Format => "has a format that this version of windlass does not know",
        MalformedInfo::Crc => "is damaged: its CRC is wrong",
    }
}

const fn malformed_header(error: MalformedHeader) -> &'static str {
    match error {
        MalformedHeader::Magic => {
            "is damaged or overwritten: something else stands in the last 256 bytes of page 30"
        }
        MalformedHeader::Format => "has a format that this version of windlass does not know",
        MalformedHeader::Crc => "is damaged: its CRC is wrong",
        MalformedHeader::Content => "contradicts itself",
    }
}

impl FileError {
    /// What the user can do about it.
    #[must_use]
    pub fn next_step(&self) -> &'static str {
        match self {
            Self::Read { .. } => "check the name and the permissions of the file",
            Self::Empty | Self::TooLong(_) | Self::UnknownFormat => {
                "give an .elf, .hex, .bin, .wlimg or .crf file of a Windlass application"
            }
            Self::Elf(
                ElfError::BigEndian | ElfError::WrongMachine(_) | ElfError::NotExecutable(_),
            ) => "give the linked application for a supported board, see docs/firmware.md",
            Self::Crf(CrfError::BadHeader(_)) => {
                "get the file again; files of other vendors cannot be used, see docs/flashing.md"
            }
            Self::Crf(CrfError::WrongProduct { .. }) => {
                "get the file that is meant for this product"
            }
            Self::NoApplication | Self::Info(_) | Self::Several(..) => {
                "give an application with one information block, see docs/image-format.md"
            }
            Self::BeyondSlot { .. } | Self::TooLarge(_) => {
                "make the application smaller; docs/image-format.md tells the room of each hardware"
            }
            Self::Hardware(_)
            | Self::Container(ContainerError::UnknownFormat(_))
            | Self::Header(MalformedHeader::Format) => "use a newer version of windlass",
            Self::Version => "give the application another version and build it again",
            Self::NotSealed => {
                "seal it right after building with `windlass image pack FILE`, or flash it with --pack"
            }
            _ => "get or build the file again; it was damaged on its way",
        }
    }
}

impl From<PackError> for FileError {
    fn from(error: PackError) -> Self {
        match error {
            PackError::Info(None) => Self::NoApplication,
            PackError::Info(Some(malformed)) => Self::Info(malformed),
            PackError::Hardware(id) => Self::Hardware(id),
            PackError::TooLarge(pages) => Self::TooLarge(pages),
            PackError::HeaderTaken => Self::Header(MalformedHeader::Magic),
            PackError::Version => Self::Version,
        }
    }
}

impl<E> From<ImageError<E>> for FileError {
    fn from(error: ImageError<E>) -> Self {
        match error {
            // Pages in memory can always be read.
            ImageError::Read(_) | ImageError::Crc => Self::Crc,
            ImageError::Header(malformed) => Self::Header(malformed),
            ImageError::Info(malformed) => Self::Info(malformed),
            ImageError::Disagree => {
                Self::Disagree("the image's header and the application tell different things")
            }
        }
    }
}
