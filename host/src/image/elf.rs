//! ELF files of a linker, read into [`Memory`].

use object::elf::{EM_ARM, ET_EXEC, FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use object::{Endian, Endianness};

use super::memory::{Memory, MemoryError};

/// Longest file in bytes; debug information makes most of it.
pub const LONGEST_FILE: usize = 64 << 20;

/// Most program headers: a linker script has a handful of segments.
const MOST_SEGMENTS: usize = 64;

/// Why an ELF file cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ElfError {
    /// The file is longer than [`LONGEST_FILE`].
    #[error("the ELF file is larger than {} MiB", LONGEST_FILE >> 20)]
    TooLong,
    /// The file header is no valid 32-bit one.
    #[error("the ELF file's header is damaged or not that of a 32-bit file")]
    BadHeader,
    /// Made for a big-endian processor.
    #[error("the ELF file is for a big-endian processor")]
    BigEndian,
    /// Made for another processor.
    #[error("the ELF file is for another processor (machine {0}, not ARM)")]
    WrongMachine(u16),
    /// A library or an object file.
    #[error("the ELF file is no linked program (type {0})")]
    NotExecutable(u16),
    /// The program headers cannot be read.
    #[error("the ELF file is damaged: its program headers lie outside the file")]
    BadProgramHeaders,
    /// More than the project's linker scripts could ever make.
    #[error("the ELF file has {0} segments, more than {MOST_SEGMENTS}")]
    TooManySegments(usize),
    /// A segment's contents lie outside the file.
    #[error("the ELF file is cut short: segment {index} lies outside the file")]
    SegmentOutside {
        /// Number of the segment, from 0.
        index: usize,
    },
    /// A segment has more contents than memory.
    #[error("the ELF file is damaged: segment {index} is larger in the file than in memory")]
    SegmentSize {
        /// Number of the segment, from 0.
        index: usize,
    },
    /// No segment has contents.
    #[error("the ELF file holds nothing to be loaded")]
    NoData,
    /// The contents cannot be placed in memory.
    #[error("the ELF file cannot be used: {0}")]
    Memory(#[from] MemoryError),
}

/// True if a file begins like an ELF file.
#[must_use]
pub fn looks_like_elf(file: &[u8]) -> bool {
    file.starts_with(b"\x7fELF")
}

/// Reads what an ELF file places in memory: the contents of its loadable segments at their load
/// (physical) addresses, which is where flash holds them.
///
/// # Errors
/// Anything malformed, or made for something else, as [`ElfError`] tells.
pub fn read(file: &[u8]) -> Result<Memory, ElfError> {
    if file.len() > LONGEST_FILE {
        return Err(ElfError::TooLong);
    }
    let header = FileHeader32::<Endianness>::parse(file).map_err(|_| ElfError::BadHeader)?;
    let endian = header.endian().map_err(|_| ElfError::BadHeader)?;
    if endian.is_big_endian() {
        return Err(ElfError::BigEndian);
    }
    let machine = header.e_machine(endian);
    if machine != EM_ARM {
        return Err(ElfError::WrongMachine(machine));
    }
    let kind = header.e_type(endian);
    if kind != ET_EXEC {
        return Err(ElfError::NotExecutable(kind));
    }
    let segments = header
        .program_headers(endian, file)
        .map_err(|_| ElfError::BadProgramHeaders)?;
    if segments.len() > MOST_SEGMENTS {
        return Err(ElfError::TooManySegments(segments.len()));
    }
    let mut memory = Memory::default();
    for (index, segment) in segments.iter().enumerate() {
        if segment.p_type(endian) != PT_LOAD {
            continue;
        }
        if segment.p_filesz(endian) > segment.p_memsz(endian) {
            return Err(ElfError::SegmentSize { index });
        }
        let contents = segment
            .data(endian, file)
            .map_err(|()| ElfError::SegmentOutside { index })?;
        memory.add(segment.p_paddr(endian), contents)?;
    }
    let memory = memory.finish()?;
    if memory.lowest().is_none() {
        return Err(ElfError::NoData);
    }
    Ok(memory)
}

/// Where the file header of a 32-bit file tells about its program headers (System V ABI, ELF header).
const PROGRAM_HEADERS_AT: usize = 28;
const PROGRAM_HEADER_COUNT_AT: usize = 44;
/// Bytes of a 32-bit program header.
const PROGRAM_HEADER_LENGTH: usize = 32;
/// Flag of a readable segment.
const PF_R: u32 = 4;

/// The same ELF file with one more loadable segment. The segment's contents and a longer table of program
/// headers are appended; nothing that is there moves.
///
/// # Errors
/// The file cannot be read, or the segment overlaps what it has.
pub fn with_segment(file: &[u8], address: u32, contents: &[u8]) -> Result<Vec<u8>, ElfError> {
    let mut memory = read(file)?;
    memory.add(address, contents)?;
    memory.finish()?;
    let header = FileHeader32::<Endianness>::parse(file).map_err(|_| ElfError::BadHeader)?;
    let endian = header.endian().map_err(|_| ElfError::BadHeader)?;
    let start = header.e_phoff(endian) as usize;
    let count = usize::from(header.e_phnum(endian));
    let end = start.saturating_add(count * PROGRAM_HEADER_LENGTH);
    let table = file.get(start..end).ok_or(ElfError::BadProgramHeaders)?;
    let mut longer = file.to_vec();
    longer.resize(file.len().next_multiple_of(4), 0);
    let at = longer.len() as u32;
    longer.extend(contents);
    longer.resize(longer.len().next_multiple_of(4), 0);
    let table_at = longer.len() as u32;
    longer.extend(table);
    let length = contents.len() as u32;
    for field in [PT_LOAD, at, address, address, length, length, PF_R, 4] {
        longer.extend(field.to_le_bytes());
    }
    let mut put = |offset: usize, bytes: &[u8]| {
        // The file header has been read, so it is there.
        if let Some(place) = longer.get_mut(offset..offset + bytes.len()) {
            place.copy_from_slice(bytes);
        }
    };
    put(PROGRAM_HEADERS_AT, &table_at.to_le_bytes());
    put(PROGRAM_HEADER_COUNT_AT, &(count as u16 + 1).to_le_bytes());
    Ok(longer)
}
