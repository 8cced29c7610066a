//! Containers with the Talon SRX's file extension `.crf` (manual 2.3).
//!
//! The layout is this project's own, because the vendor's is not public: the vendor's CRF files are not
//! read, and its tools do not read these. What is kept is what a user of the manual's update page sees:
//! six different errors for six kinds of damage. All numbers are little-endian, the CRCs CRC-32/ISO-HDLC:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `WLCRF`, 0x1A, carriage return, line feed |
//! | 8 | 2 | format version, 1 |
//! | 10 | 2 | firmware version, major and minor byte |
//! | 12 | 4 | product code |
//! | 16 | 4 | length of the file |
//! | 20 | 4 | number of sections |
//! | 24 | 4 | CRC of bytes 0 to 23 |
//!
//! Then for each section, in ascending order of address:
//!
//! | bytes | field |
//! |---|---|
//! | 4 | address: 4096 × number of its first page |
//! | 4 | length of its data, a multiple of 4096 |
//! | 4 | CRC of the data |
//! | 4 | CRC of the 12 bytes before |
//! | … | data |

use windlass_core::boot::image::{Header, LAST_PAGE, PAGE_SIZE};
use windlass_core::crc::iso_hdlc;

use super::bytes::Reader;
use super::pages::Pages;

const MAGIC: [u8; 8] = *b"WLCRF\x1A\r\n";
const FORMAT: u16 = 1;
/// Bytes of the header with its CRC.
const HEADER_LENGTH: usize = 28;
/// Bytes of a section's header with its CRC.
const SECTION_HEADER_LENGTH: usize = 16;
/// Most sections: every second page.
const MOST_SECTIONS: u32 = LAST_PAGE as u32 / 2 + 1;

/// Longest file in bytes.
pub const LONGEST_FILE: usize = HEADER_LENGTH
    + MOST_SECTIONS as usize * SECTION_HEADER_LENGTH
    + (LAST_PAGE as usize + 1) * PAGE_SIZE;

/// What the file says about its image, to be compared with the image's own header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Label {
    /// Firmware version, major and minor byte.
    pub version: u16,
    /// Product the image is for.
    pub product: u32,
}

impl Label {
    /// What the file of an image with this header says.
    #[must_use]
    pub const fn of(header: &Header) -> Self {
        Self {
            version: header.identity.version,
            product: header.identity.product,
        }
    }
}

/// Why a `.crf` file cannot be used. The first six stand for the checks of the Talon's update page; the
/// numbers are those that its successor is known to report ([`CrfError::code`]).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CrfError {
    /// The header is damaged or of another format.
    #[error("CRF error -200, bad header: {0}")]
    BadHeader(&'static str),
    /// The file's length is not the one its header names.
    #[error("CRF error -201, wrong file size: {found} bytes instead of {expected}")]
    FileSize {
        /// Bytes of the file.
        found: usize,
        /// What its header says.
        expected: u32,
    },
    /// Made for another product.
    #[error(
        "CRF error -202, wrong product: the file is for {found:#010x}, its image for {expected:#010x}"
    )]
    WrongProduct {
        /// Product code of the file.
        found: u32,
        /// Product code of the image inside.
        expected: u32,
    },
    /// There are no sections.
    #[error("CRF error -203, no sections")]
    NoSections,
    /// A section's header is damaged.
    #[error("CRF error -204, bad section header: section {index} {reason}")]
    BadSectionHeader {
        /// Number of the section, from 0.
        index: u32,
        /// What is wrong.
        reason: &'static str,
    },
    /// A section's data has another length than its header names.
    #[error("CRF error -205, bad section size: section {index} names {length} bytes")]
    BadSectionSize {
        /// Number of the section, from 0.
        index: u32,
        /// Length in its header.
        length: u32,
    },
    /// A section's data is damaged. The Talon's page is not known to have a number for this.
    #[error("the CRF file's section {index} is damaged: the CRC of its data is wrong")]
    SectionCrc {
        /// Number of the section, from 0.
        index: u32,
    },
}

impl CrfError {
    /// The number by which the Talon's update page is known to report this check, if it has one.
    #[must_use]
    pub const fn code(&self) -> Option<i32> {
        match self {
            Self::BadHeader(_) => Some(-200),
            Self::FileSize { .. } => Some(-201),
            Self::WrongProduct { .. } => Some(-202),
            Self::NoSections => Some(-203),
            Self::BadSectionHeader { .. } => Some(-204),
            Self::BadSectionSize { .. } => Some(-205),
            Self::SectionCrc { .. } => None,
        }
    }
}

/// True if a file begins like this project's `.crf`.
#[must_use]
pub fn looks_like_crf(file: &[u8]) -> bool {
    file.starts_with(&MAGIC[..5])
}

/// Reads a `.crf` file.
///
/// # Errors
/// Any damage, as [`CrfError`] tells.
pub fn read(file: &[u8]) -> Result<(Label, Pages), CrfError> {
    let (label, sections, mut rest) = read_header(file)?;
    let mut pages = Pages::default();
    let mut next_page = 0;
    for index in 0..sections {
        let (first, data) = read_section(&mut rest, index, next_page)?;
        for (number, contents) in (first..).zip(data.chunks(PAGE_SIZE)) {
            if !pages.put(number, 0, contents) {
                let length = data.len() as u32;
                return Err(CrfError::BadSectionSize { index, length });
            }
            next_page = number + 1;
        }
    }
    if !rest.0.is_empty() {
        return Err(CrfError::BadHeader(
            "it names fewer sections than there are",
        ));
    }
    Ok((label, pages))
}

fn read_header(file: &[u8]) -> Result<(Label, u32, Reader<'_>), CrfError> {
    const CUT: CrfError = CrfError::BadHeader("the file is cut short");
    let mut rest = Reader(file);
    if rest.array() != Some(MAGIC) {
        return Err(CrfError::BadHeader(
            "the first bytes are damaged, or this is a vendor's file, which cannot be read",
        ));
    }
    let format = rest.u16().ok_or(CUT)?;
    let version = rest.u16().ok_or(CUT)?;
    let product = rest.u32().ok_or(CUT)?;
    let length = rest.u32().ok_or(CUT)?;
    let sections = rest.u32().ok_or(CUT)?;
    let stated = rest.u32().ok_or(CUT)?;
    if iso_hdlc(&file[..HEADER_LENGTH - 4]) != stated {
        return Err(CrfError::BadHeader("its CRC is wrong"));
    }
    if format != FORMAT {
        return Err(CrfError::BadHeader("a newer version of windlass made it"));
    }
    if length as usize != file.len() {
        return Err(CrfError::FileSize {
            found: file.len(),
            expected: length,
        });
    }
    if sections == 0 {
        return Err(CrfError::NoSections);
    }
    if sections > MOST_SECTIONS {
        return Err(CrfError::BadHeader("it names too many sections"));
    }
    Ok((Label { version, product }, sections, rest))
}

/// The first page and the data of the next section, which may not begin before `lowest`.
fn read_section<'a>(
    rest: &mut Reader<'a>,
    index: u32,
    lowest: u8,
) -> Result<(u8, &'a [u8]), CrfError> {
    let bad = |reason| CrfError::BadSectionHeader { index, reason };
    let header = rest
        .take(SECTION_HEADER_LENGTH)
        .ok_or_else(|| bad("is missing"))?;
    let mut fields = Reader(header);
    let (Some(address), Some(length), Some(data_crc), Some(stated)) =
        (fields.u32(), fields.u32(), fields.u32(), fields.u32())
    else {
        return Err(bad("is missing"));
    };
    if iso_hdlc(&header[..SECTION_HEADER_LENGTH - 4]) != stated {
        return Err(bad("has a header with a wrong CRC"));
    }
    let first = u8::try_from(address / PAGE_SIZE as u32).unwrap_or(u8::MAX);
    if address % PAGE_SIZE as u32 != 0 || first > LAST_PAGE {
        return Err(bad("has an address that is no page of an application"));
    }
    if first < lowest {
        return Err(bad("overlaps the one before or is out of order"));
    }
    let size = CrfError::BadSectionSize { index, length };
    if length == 0 || !(length as usize).is_multiple_of(PAGE_SIZE) {
        return Err(size);
    }
    let data = rest.take(length as usize).ok_or(size)?;
    if iso_hdlc(data) != data_crc {
        return Err(CrfError::SectionCrc { index });
    }
    Ok((first, data))
}

/// Writes a `.crf` file: one section for each run of pages.
#[must_use]
pub fn write(label: Label, pages: &Pages) -> Vec<u8> {
    let mut runs: Vec<(u8, Vec<u8>)> = Vec::new();
    let mut next = 0;
    for (number, contents) in pages.iter() {
        match runs.last_mut() {
            Some((_, data)) if next == number => data.extend(contents),
            _ => runs.push((number, contents.to_vec())),
        }
        next = number + 1;
    }
    let data: usize = runs.iter().map(|(_, data)| data.len()).sum();
    let length = HEADER_LENGTH + runs.len() * SECTION_HEADER_LENGTH + data;
    let mut file = Vec::with_capacity(length);
    file.extend(MAGIC);
    file.extend(FORMAT.to_le_bytes());
    file.extend(label.version.to_le_bytes());
    file.extend(label.product.to_le_bytes());
    file.extend((length as u32).to_le_bytes());
    file.extend((runs.len() as u32).to_le_bytes());
    let crc = iso_hdlc(&file);
    file.extend(crc.to_le_bytes());
    for (first, data) in runs {
        let start = file.len();
        file.extend((u32::from(first) * PAGE_SIZE as u32).to_le_bytes());
        file.extend((data.len() as u32).to_le_bytes());
        file.extend(iso_hdlc(&data).to_le_bytes());
        let crc = iso_hdlc(&file[start..]);
        file.extend(crc.to_le_bytes());
        file.extend(data);
    }
    file
}
