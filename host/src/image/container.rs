//! The project's container `.wlimg`: the pages of a packed image, sealed by CRCs that cover every byte.
//!
//! All numbers are little-endian, all CRCs CRC-32/ISO-HDLC:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `WLIMG`, 0x1A, carriage return, line feed (a transfer as text breaks it) |
//! | 8 | 2 | format version, 1 |
//! | 10 | 2 | firmware version, major and minor byte |
//! | 12 | 4 | length of the file |
//! | 16 | 4 | product id |
//! | 20 | 4 | hardware id |
//! | 24 | 4 | bitmap of the pages |
//! | 28 | 4 × pages | CRC of each page, ascending |
//! | | 4 | CRC of everything before |
//! | | 4096 × pages | the pages, ascending |

use windlass_core::boot::image::{Header, LAST_PAGE, PAGE_SIZE};
use windlass_core::crc::iso_hdlc;

use super::bytes::Reader;
use super::pages::Pages;

const MAGIC: [u8; 8] = *b"WLIMG\x1A\r\n";
const FORMAT: u16 = 1;
/// Bytes before the CRCs of the pages.
const FIXED_LENGTH: usize = 28;
const PAGE_BITS: u32 = (1 << (LAST_PAGE + 1)) - 1;

/// Longest file in bytes: all pages.
pub const LONGEST_FILE: usize = FIXED_LENGTH + 4 + (LAST_PAGE as usize + 1) * (PAGE_SIZE + 4);

/// What the container says about its image, to be compared with the image's own header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Label {
    /// Firmware version, major and minor byte.
    pub version: u16,
    /// Product the image is for.
    pub product: u32,
    /// Hardware the image is for.
    pub hardware: u32,
}

impl Label {
    /// What the container of an image with this header says.
    #[must_use]
    pub const fn of(header: &Header) -> Self {
        Self {
            version: header.identity.version,
            product: header.identity.product,
            hardware: header.identity.hardware,
        }
    }
}

/// Why a container cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ContainerError {
    /// It does not begin as a container does.
    #[error("the container's first bytes are damaged")]
    BadMagic,
    /// Made by a newer version of this tool.
    #[error("the container has format {0}; this version of windlass reads format {FORMAT}")]
    UnknownFormat(u16),
    /// Its length is not the one it names.
    #[error("the container has {found} bytes and should have {expected}")]
    Length {
        /// Bytes of the file.
        found: usize,
        /// What its header says.
        expected: u64,
    },
    /// The CRC of its header is wrong.
    #[error("the container's header is damaged: its CRC is wrong")]
    HeaderCrc,
    /// It names pages that do not exist, or not as many as its length has room for.
    #[error("the container's page list makes no sense")]
    BadPages,
    /// The CRC of a page is wrong.
    #[error("the container's page {0} is damaged: its CRC is wrong")]
    PageCrc(u8),
}

/// True if a file begins like a container.
#[must_use]
pub fn looks_like_container(file: &[u8]) -> bool {
    file.starts_with(&MAGIC[..5])
}

/// Reads a container.
///
/// # Errors
/// Any damage, as [`ContainerError`] tells.
pub fn read(file: &[u8]) -> Result<(Label, Pages), ContainerError> {
    let cut = || ContainerError::Length {
        found: file.len(),
        expected: FIXED_LENGTH as u64 + 4,
    };
    let mut rest = Reader(file);
    if rest.array() != Some(MAGIC) {
        return Err(ContainerError::BadMagic);
    }
    let format = rest.u16().ok_or_else(cut)?;
    if format != FORMAT {
        return Err(ContainerError::UnknownFormat(format));
    }
    let version = rest.u16().ok_or_else(cut)?;
    let length = rest.u32().ok_or_else(cut)?;
    let product = rest.u32().ok_or_else(cut)?;
    let hardware = rest.u32().ok_or_else(cut)?;
    let bitmap = rest.u32().ok_or_else(cut)?;
    if u64::from(length) != file.len() as u64 {
        return Err(ContainerError::Length {
            found: file.len(),
            expected: u64::from(length),
        });
    }
    let count = bitmap.count_ones() as usize;
    if bitmap & !PAGE_BITS != 0 || file.len() != FIXED_LENGTH + 4 + count * (PAGE_SIZE + 4) {
        return Err(ContainerError::BadPages);
    }
    let crcs = rest.take(4 * count).ok_or(ContainerError::BadPages)?;
    let stated = rest.u32().ok_or(ContainerError::BadPages)?;
    if iso_hdlc(&file[..FIXED_LENGTH + crcs.len()]) != stated {
        return Err(ContainerError::HeaderCrc);
    }
    let mut pages = Pages::default();
    let mut crcs = Reader(crcs);
    for number in (0..=LAST_PAGE).filter(|number| bitmap & 1 << number != 0) {
        let contents = rest.take(PAGE_SIZE).ok_or(ContainerError::BadPages)?;
        if crcs.u32() != Some(iso_hdlc(contents)) {
            return Err(ContainerError::PageCrc(number));
        }
        if !pages.put(number, 0, contents) {
            return Err(ContainerError::BadPages);
        }
    }
    let label = Label {
        version,
        product,
        hardware,
    };
    Ok((label, pages))
}

/// Writes a container.
#[must_use]
pub fn write(label: Label, pages: &Pages) -> Vec<u8> {
    let length = FIXED_LENGTH + 4 + pages.len() * (PAGE_SIZE + 4);
    let mut file = Vec::with_capacity(length);
    file.extend(MAGIC);
    file.extend(FORMAT.to_le_bytes());
    file.extend(label.version.to_le_bytes());
    file.extend((length as u32).to_le_bytes());
    file.extend(label.product.to_le_bytes());
    file.extend(label.hardware.to_le_bytes());
    file.extend(pages.bitmap().to_le_bytes());
    for (_, contents) in pages.iter() {
        file.extend(iso_hdlc(contents).to_le_bytes());
    }
    let crc = iso_hdlc(&file);
    file.extend(crc.to_le_bytes());
    for (_, contents) in pages.iter() {
        file.extend(contents);
    }
    file
}
