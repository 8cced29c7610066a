//! What an application image looks like: pages, information block and header.
//!
//! An image is a set of the update protocol's pages. Page 0 holds the vector table and, at a fixed offset,
//! the [`InfoBlock`] that the application itself carries. The last page, 30, ends with the [`Header`] that
//! packing makes: it names the pages that belong to the image and the CRC over them. Since page 30 is the
//! first page that a host sends (DMC60C guide, "Firmware Updates"), a controller knows what is coming
//! before it erases anything.
//!
//! Every offset is in docs/image-format.md.

mod block;
mod seal;

#[cfg(test)]
mod tests;

pub use block::{
    HEADER_FORMAT, HEADER_LENGTH, HEADER_MAGIC, HEADER_OFFSET, Header, INFO_FORMAT, INFO_LENGTH,
    INFO_MAGIC, INFO_OFFSET, Identity, InfoBlock, MalformedHeader, MalformedInfo, NO_VERSION,
    SIGNATURE_LENGTH, SIGNED_LENGTH, UNSIGNED_SIGNATURE,
};
pub(super) use seal::read_header;
pub use seal::{
    ImageCrc, ImageError, PackError, ReadPages, is_blank, is_covered, pack, put_signature,
    signed_message, verify,
};

/// Bytes of a page as it travels (guide, `vcmdEraseWriteFlashPage`: 1024 instructions of 4 bytes).
///
/// All of them are stored and covered by the image's CRC: unlike the DMC60C's processor, a Cortex-M has no
/// bytes that do not exist.
pub const PAGE_SIZE: usize = 4096;

/// Pages that an application may have, 0 to 30 (guide, "Firmware Updates").
pub const PAGE_COUNT: u8 = 31;

/// The page with the header, sent first.
pub const LAST_PAGE: u8 = PAGE_COUNT - 1;

/// The page with the vector table, sent last.
pub const FIRST_PAGE: u8 = 0;

/// Pages that every image has: the first and the last.
pub const REQUIRED_PAGES: u32 = 1 << LAST_PAGE | 1 << FIRST_PAGE;

/// Bits that a page bitmap may have.
pub const ALL_PAGES: u32 = (1 << PAGE_COUNT as u32) - 1;

/// One page.
pub type Page = [u8; PAGE_SIZE];

/// A kind of hardware that images are made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hardware {
    /// Hardware id in header and information block.
    pub id: u32,
    /// Name of the microcontroller family member, in lower case.
    pub name: &'static str,
    /// Pages of the application that its slot can hold, as a bitmap.
    pub pages: u32,
}

impl Hardware {
    /// STM32F405, its emulation and the bench's default.
    pub const F405: Self = Self {
        id: 0x0000_0405,
        name: "stm32f405",
        pages: ALL_PAGES,
    };

    /// STM32G474.
    pub const G474: Self = Self {
        id: 0x0000_0474,
        name: "stm32g474",
        pages: ALL_PAGES,
    };

    /// STM32G431: its 128 KiB leave room for the pages 0 to 22 and 30.
    pub const G431: Self = Self {
        id: 0x0000_0431,
        name: "stm32g431",
        pages: ((1 << 23) - 1) | (1 << LAST_PAGE),
    };

    /// Every hardware id.
    pub const TABLE: [Self; 3] = [Self::F405, Self::G474, Self::G431];

    /// The hardware of an id.
    #[must_use]
    pub fn from_id(id: u32) -> Option<Self> {
        Self::TABLE.into_iter().find(|row| row.id == id)
    }

    /// The hardware of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::TABLE.into_iter().find(|row| row.name == name)
    }
}

/// The pages of a bitmap in ascending order.
pub fn pages_of(bitmap: u32) -> impl Iterator<Item = u8> {
    (0..PAGE_COUNT).filter(move |page| bitmap >> page & 1 != 0)
}
