//! From a firmware file of any format to its pages.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use windlass_core::boot::image::{
    ALL_PAGES, FIRST_PAGE, HEADER_OFFSET, Hardware, Header, INFO_LENGTH, INFO_MAGIC, INFO_OFFSET,
    InfoBlock, LAST_PAGE, PAGE_SIZE, is_blank, pages_of,
};

use super::crf::CrfError;
use super::error::FileError;
use super::memory::Memory;
use super::pages::Pages;
use super::{container, crf, elf, hex};

/// A kind of firmware file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A linker's ELF file.
    Elf,
    /// Intel HEX.
    Hex,
    /// The bare contents of the slot from its first byte on.
    Bin,
    /// The project's container.
    Container,
    /// The project's container with the Talon SRX's extension.
    Crf,
}

impl Format {
    /// Every format with its name and the extensions of its files.
    pub const TABLE: [(Self, &str, &[&str]); 5] = [
        (Self::Elf, "elf", &["elf", "axf", "out"]),
        (Self::Hex, "hex", &["hex", "ihex", "ihx"]),
        (Self::Bin, "bin", &["bin"]),
        (Self::Container, "wlimg", &["wlimg"]),
        (Self::Crf, "crf", &["crf"]),
    ];

    /// The format's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        let row = Self::TABLE.iter().find(|row| row.0 == self);
        row.map_or("?", |row| row.1)
    }

    /// The format that a file of this name has.
    #[must_use]
    pub fn of_name(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        let row = Self::TABLE
            .iter()
            .find(|row| row.2.contains(&extension.as_str()));
        row.map(|row| row.0)
    }

    /// The format of a file: by its first bytes, else by its name. A bare binary has no first bytes of its
    /// own, so its name alone decides.
    #[must_use]
    pub fn detect(path: &Path, file: &[u8]) -> Option<Self> {
        let named = Self::of_name(path);
        if named == Some(Self::Bin) {
            return named;
        }
        if elf::looks_like_elf(file) {
            Some(Self::Elf)
        } else if container::looks_like_container(file) {
            Some(Self::Container)
        } else if crf::looks_like_crf(file) {
            Some(Self::Crf)
        } else if hex::looks_like_hex(file) {
            Some(Self::Hex)
        } else {
            named
        }
    }

    /// Longest file of this format in bytes.
    const fn longest(self) -> usize {
        match self {
            Self::Elf => elf::LONGEST_FILE,
            Self::Hex => hex::LONGEST_FILE,
            Self::Bin => (LAST_PAGE as usize + 1) * PAGE_SIZE,
            Self::Container => container::LONGEST_FILE,
            Self::Crf => crf::LONGEST_FILE,
        }
    }
}

/// What a file holds: pages that may have a header already.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contents {
    /// Format of the file.
    pub format: Format,
    /// The pages.
    pub pages: Pages,
    /// Address of page 0 in the file; 0 for files that know only pages.
    pub base: u32,
    /// What was left out, one sentence each.
    pub notices: Vec<String>,
}

impl Contents {
    /// True if page 30 ends with something, which then has to be the header.
    #[must_use]
    pub fn is_sealed(&self) -> bool {
        let last = self.pages.get(LAST_PAGE);
        last.is_some_and(|page| !is_blank(&page[HEADER_OFFSET..]))
    }
}

/// Reads a file of the disk, no more of it than its format may have.
///
/// # Errors
/// The file cannot be read, or is of no known format, or is damaged.
pub fn load(path: &Path) -> Result<Contents, FileError> {
    let failed = |source| FileError::Read {
        path: path.to_owned(),
        source,
    };
    let longest = elf::LONGEST_FILE as u64 + 1;
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(longest).read_to_end(&mut bytes))
        .map_err(failed)?;
    let format = Format::detect(path, &bytes).ok_or(if bytes.is_empty() {
        FileError::Empty
    } else {
        FileError::UnknownFormat
    })?;
    parse(format, &bytes)
}

/// Reads the bytes of a file.
///
/// # Errors
/// Any damage, each kind with its own error.
pub fn parse(format: Format, bytes: &[u8]) -> Result<Contents, FileError> {
    if bytes.is_empty() {
        return Err(FileError::Empty);
    }
    if bytes.len() > format.longest() {
        return Err(FileError::TooLong(format.longest()));
    }
    let mut contents = match format {
        Format::Elf => place(format, &elf::read(bytes)?)?,
        Format::Hex => place(format, &hex::read(bytes)?)?,
        Format::Bin => place_binary(bytes)?,
        Format::Container => {
            let (label, pages) = container::read(bytes)?;
            let contents = only_pages(format, pages);
            let header = check_seal(&contents)?;
            let stated = container::Label::of(&header);
            if label != stated || header.pages != contents.pages.bitmap() {
                return Err(FileError::Disagree(
                    "the container and the image in it tell different things",
                ));
            }
            contents
        }
        Format::Crf => {
            let (label, pages) = crf::read(bytes)?;
            let contents = only_pages(format, pages);
            let header = check_seal(&contents)?;
            if label.product != header.identity.product {
                return Err(CrfError::WrongProduct {
                    found: label.product,
                    expected: header.identity.product,
                }
                .into());
            }
            if label != crf::Label::of(&header) || header.pages != contents.pages.bitmap() {
                return Err(FileError::Disagree(
                    "the CRF file and the image in it tell different things",
                ));
            }
            contents
        }
    };
    if contents.is_sealed() {
        let header = check_seal(&contents)?;
        drop_blank(&mut contents.pages, header.pages);
        if contents.pages.bitmap() & !header.pages != 0 {
            return Err(FileError::Disagree(
                "the file has pages that the image's header does not name",
            ));
        }
        // A page without contents may be missing in a HEX or ELF file; it is sent nevertheless.
        for number in pages_of(header.pages) {
            let put = contents.pages.put(number, 0, &[]);
            debug_assert!(put, "a header names pages that exist");
        }
    } else {
        drop_blank(&mut contents.pages, 0);
        read_info(&contents.pages)?;
    }
    Ok(contents)
}

/// The header of sealed pages, after checking everything that it covers.
pub(super) fn check_seal(contents: &Contents) -> Result<Header, FileError> {
    let header = windlass_core::boot::image::verify(&mut &contents.pages, |_| ())?;
    let hardware = Hardware::from_id(header.identity.hardware);
    let beyond = header.pages & !hardware.map_or(u32::MAX, |row| row.pages);
    if beyond != 0 {
        return Err(FileError::TooLarge(beyond));
    }
    Ok(header)
}

const fn only_pages(format: Format, pages: Pages) -> Contents {
    Contents {
        format,
        pages,
        base: 0,
        notices: Vec::new(),
    }
}

fn read_info(pages: &Pages) -> Result<InfoBlock, FileError> {
    let page = pages.get(FIRST_PAGE).ok_or(FileError::NoApplication)?;
    InfoBlock::parse(&page[INFO_OFFSET..]).map_err(FileError::Info)
}

/// Pages without contents, which a binary has between its last byte and the header, are no pages of the
/// image unless the header names them.
fn drop_blank(pages: &mut Pages, named: u32) {
    for number in pages_of(pages.bitmap() & !named) {
        if pages.get(number).is_some_and(|page| is_blank(page)) {
            pages.remove(number);
        }
    }
}

/// Puts a binary's bytes into pages; how many there are depends on the hardware that it is for.
fn place_binary(bytes: &[u8]) -> Result<Contents, FileError> {
    let mut memory = Memory::default();
    // A binary is shorter than the address space.
    let added = memory.add(0, bytes);
    match added.and_then(|()| memory.finish()) {
        Ok(memory) => {
            let room = slot_pages(Format::Bin, &memory, 0)?;
            fill(Format::Bin, &memory, 0, &room)
        }
        Err(_) => Err(FileError::TooLong(Format::Bin.longest())),
    }
}

/// Puts what a linker has placed into pages. The slot begins where the information block says that page 0
/// is.
fn place(format: Format, memory: &Memory) -> Result<Contents, FileError> {
    let base = find_base(memory)?;
    let room = slot_pages(format, memory, base)?;
    fill(format, memory, base, &room)
}

/// The address of page 0: that of the one page that has an information block.
fn find_base(memory: &Memory) -> Result<u32, FileError> {
    let mut found: Option<u32> = None;
    for run in memory.runs() {
        let places = run.bytes.windows(INFO_MAGIC.len()).enumerate();
        for (at, _) in places.filter(|(_, bytes)| *bytes == INFO_MAGIC) {
            let base = u64::from(run.address) + at as u64;
            let Some(base) = base.checked_sub(INFO_OFFSET as u64) else {
                continue;
            };
            let base = u32::try_from(base).unwrap_or(u32::MAX);
            if !(base as usize).is_multiple_of(PAGE_SIZE) {
                continue;
            }
            if let Some(first) = found.replace(base) {
                return Err(FileError::Several(first, base));
            }
        }
    }
    found.ok_or(FileError::NoApplication)
}

/// The pages of the slot in the order in which they stand there.
fn slot_pages(format: Format, memory: &Memory, base: u32) -> Result<Vec<u8>, FileError> {
    let block = memory.read::<INFO_LENGTH>(base.saturating_add(INFO_OFFSET as u32));
    let info = InfoBlock::parse(&block).map_err(FileError::Info)?;
    let id = info.identity.hardware;
    let hardware = Hardware::from_id(id).ok_or(FileError::Hardware(id))?;
    // A HEX file in the guide's form has every page at its number, whatever the hardware has room for.
    let guide = format == Format::Hex && base == 0;
    let pages = if guide { ALL_PAGES } else { hardware.pages };
    Ok(pages_of(pages).collect())
}

/// Cuts memory into pages. Bytes below the slot belong to a bootloader and are left out with a notice; so
/// are pages beyond 30 of a HEX file in the guide's form. Bytes behind the slot are an application that
/// does not fit.
fn fill(format: Format, memory: &Memory, base: u32, room: &[u8]) -> Result<Contents, FileError> {
    let end = u64::from(base) + (room.len() * PAGE_SIZE) as u64;
    let mut pages = Pages::default();
    let (mut below, mut beyond) = (0, 0);
    for run in memory.runs() {
        let mut at = u64::from(run.address);
        let mut rest = run.bytes.as_slice();
        while !rest.is_empty() {
            if at < u64::from(base) {
                let count = rest.len().min((u64::from(base) - at) as usize);
                below += count;
                at += count as u64;
                rest = rest.get(count..).unwrap_or_default();
                continue;
            }
            if at >= end {
                if base == 0 && format == Format::Hex {
                    beyond += rest.len();
                    break;
                }
                return Err(FileError::BeyondSlot {
                    address: at as u32,
                    end: end as u32,
                });
            }
            let offset = (at - u64::from(base)) as usize;
            let within = offset % PAGE_SIZE;
            let count = rest.len().min(PAGE_SIZE - within);
            let (bytes, after) = rest.split_at(count);
            let put = room
                .get(offset / PAGE_SIZE)
                .is_some_and(|page| pages.put(*page, within, bytes));
            debug_assert!(put, "a page of the slot has room for its own bytes");
            at += count as u64;
            rest = after;
        }
    }
    let mut notices = Vec::new();
    if below > 0 {
        notices.push(format!(
            "{below} bytes below the application's slot at {base:#010x} are left out: the bootloader stands there"
        ));
    }
    if beyond > 0 {
        notices.push(format!(
            "{beyond} bytes in pages beyond 30 are left out: they belong to no application"
        ));
    }
    Ok(Contents {
        format,
        pages,
        base,
        notices,
    })
}
