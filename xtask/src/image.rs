//! Reads an image: its sections, its symbols, and the bytes that belong into flash.

use std::fs;
use std::path::{Path, PathBuf};

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, elf};

use crate::board::Board;
use crate::error::Error;
use crate::stack::Bound;

/// Flash starts here on every STM32.
const FLASH_START: u64 = 0x0800_0000;

/// What an image is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// In the region BOOT.
    Bootloader,
    /// In the region FLASH.
    Application,
}

impl Part {
    /// Name of its region.
    const fn region(self) -> &'static str {
        match self {
            Self::Bootloader => "BOOT",
            Self::Application => "FLASH",
        }
    }

    /// Budgets of a real board in bytes: flash, and RAM. The application's RAM is the static one, beside its stack; the
    /// bootloader's is all of it, stack included.
    pub(crate) const fn budget(self, signed: bool) -> (u64, u64) {
        match self {
            // Points of the curve take 2 KiB more of the stack than anything else that a bootloader does.
            Self::Bootloader if signed => (20 * 1024, 9 * 1024),
            Self::Bootloader => (8 * 1024, 6 * 1024),
            // The goal is 40 KiB; the second dialect took 8 KiB, the settings journal and the slots 8 KiB, and what of
            // it can be won back is open (docs/firmware.md).
            Self::Application => (54 * 1024, 8 * 1024),
        }
    }
}

/// A section that takes up memory.
#[derive(Clone, Debug)]
pub(crate) struct Section {
    pub(crate) name: String,
    pub(crate) address: u64,
    pub(crate) size: u64,
    /// It has contents, which stand in flash.
    pub(crate) loaded: bool,
}

/// One linked image.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    path: PathBuf,
    pub(crate) sections: Vec<Section>,
    /// Contents by load address, in ascending order.
    segments: Vec<(u32, Vec<u8>)>,
    /// Symbols with name and address; functions without the Thumb bit.
    pub(crate) symbols: Vec<(String, u64)>,
}

impl Image {
    /// Reads a linked file.
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let bytes = fs::read(path).map_err(|cause| Error::File {
            path: path.to_owned(),
            cause,
        })?;
        let broken = |what: String| Error::Image {
            path: path.to_owned(),
            what,
        };
        let file = ElfFile32::<object::LittleEndian>::parse(&*bytes)
            .map_err(|error| broken(error.to_string()))?;
        let mut sections = Vec::new();
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
                continue;
            };
            if sh_flags & u64::from(elf::SHF_ALLOC) != 0 && section.size() > 0 {
                sections.push(Section {
                    name: section.name().unwrap_or("?").to_owned(),
                    address: section.address(),
                    size: section.size(),
                    loaded: section.file_range().is_some(),
                });
            }
        }
        let mut segments = Vec::new();
        let endian = file.endian();
        for header in file.elf_program_headers() {
            if header.p_type(endian) != elf::PT_LOAD || header.p_filesz(endian) == 0 {
                continue;
            }
            let contents = header
                .data(endian, &*bytes)
                .map_err(|()| broken("a segment lies outside the file".to_owned()))?;
            segments.push((header.p_paddr(endian), contents.to_vec()));
        }
        segments.sort();
        let symbols = file
            .symbols()
            .filter_map(|symbol| Some((symbol.name().ok()?.to_owned(), symbol.address() & !1)))
            .collect();
        Ok(Self {
            path: path.to_owned(),
            sections,
            segments,
            symbols,
        })
    }

    /// Address of a symbol.
    pub(crate) fn symbol(&self, name: &str) -> Result<u64, Error> {
        self.symbols
            .iter()
            .find(|(candidate, _)| candidate == name)
            .map(|(_, address)| *address)
            .ok_or_else(|| Error::Image {
                path: self.path.clone(),
                what: format!("it has no symbol {name}"),
            })
    }

    fn sum(&self, wanted: impl Fn(&Section) -> bool) -> u64 {
        self.sections
            .iter()
            .filter(|section| wanted(section))
            .map(|section| section.size)
            .sum()
    }

    /// Bytes in flash: everything with contents.
    pub(crate) fn flash(&self) -> u64 {
        self.segments
            .iter()
            .map(|(_, contents)| contents.len() as u64)
            .sum()
    }

    /// Bytes of static RAM.
    pub(crate) fn ram(&self) -> u64 {
        self.sum(|section| section.address >= 0x2000_0000)
    }

    /// Where it stands.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// What stands in flash, by load address.
    pub(crate) fn segments(&self) -> &[(u32, Vec<u8>)] {
        &self.segments
    }
}

/// Start and length of a region in the text of a memory map.
fn region(map: &str, name: &str) -> Option<(u64, u64)> {
    let line = map
        .lines()
        .find(|line| line.split_whitespace().next() == Some(name))?;
    let value = |key: &str| {
        let text = line.split_once(key)?.1.trim_start().strip_prefix('=')?;
        let word = text
            .trim_start()
            .split([',', ' '])
            .next()
            .unwrap_or_default();
        match (word.strip_prefix("0x"), word.strip_suffix('K')) {
            (Some(digits), _) => u64::from_str_radix(digits, 16).ok(),
            (_, Some(digits)) => Some(digits.parse::<u64>().ok()? * 1024),
            _ => word.parse().ok(),
        }
    };
    Some((value("ORIGIN")?, value("LENGTH")?))
}

/// A region of a board: start and length.
pub(crate) fn region_of(board: &Board, name: &'static str) -> Result<(u64, u64), Error> {
    let path = crate::root().join(board.map);
    let map = fs::read_to_string(&path).map_err(|cause| Error::File {
        path: path.clone(),
        cause,
    })?;
    region(&map, name).ok_or_else(|| Error::Image {
        path,
        what: format!("it names no region {name} with ORIGIN and LENGTH"),
    })
}

/// Prints sections and totals next to region and budgets. An image beyond its region or its budgets is an error, but for the
/// bootloader's flash: that budget is a goal that it misses (docs/firmware.md).
pub(crate) fn report(image: &Image, board: &Board, part: Part) -> Result<(), Error> {
    println!("\nsection            address       bytes");
    for section in &image.sections {
        println!(
            "{:<18} 0x{:08x} {:>9}{}",
            section.name,
            section.address,
            section.size,
            if section.loaded && section.address >= FLASH_START {
                ""
            } else {
                "  (not in flash)"
            },
        );
    }
    let (start, length) = region_of(board, part.region())?;
    let (flash_budget, ram_budget) = part.budget(board.signed);
    let vectors = image.symbol("__vector_table")?;
    if vectors != start {
        return Err(Error::Image {
            path: image.path.clone(),
            what: format!("its vectors stand at {vectors:#x}, the region of the map at {start:#x}"),
        });
    }
    let (flash, ram) = (image.flash(), image.ram());
    let stack = Bound::of(image, board, part)?;
    println!("flash   {flash:>6} of {flash_budget} bytes budgeted, {length} in the region");
    match part {
        Part::Application => println!("RAM     {ram:>6} of {ram_budget} bytes budgeted, static"),
        Part::Bootloader => println!(
            "RAM     {:>6} of {ram_budget} bytes budgeted: {ram} static, and the stack",
            ram + stack.total
        ),
    }
    println!(
        "stack   {:>6} of {} bytes reserved, in the worst case (`cargo xtask stack`)",
        stack.total, stack.region
    );
    stack.check(ram, board, part)?;
    if flash > length {
        return Err(Error::TooLarge {
            what: format!("{flash} of {length} bytes of {}", part.region()),
        });
    }
    if !board.budgeted {
        println!("(the budgets are those of real boards)");
    } else if part == Part::Bootloader {
        if flash > flash_budget {
            println!("(beyond the goal by {} bytes)", flash - flash_budget);
        }
    } else if flash > flash_budget || ram > ram_budget {
        return Err(Error::TooLarge {
            what: format!(
                "flash {flash} of {flash_budget} bytes, static RAM {ram} of {ram_budget} bytes"
            ),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::BOARDS;

    #[test]
    fn every_board_s_map_tells_its_slot() {
        for board in BOARDS {
            let (start, length) = region_of(&board, "FLASH").expect("a slot");
            // Whole pages of the update protocol, and an aligned vector table.
            assert_eq!((start % 512, length % 4096), (0, 0), "{}", board.name);
            assert!(start > FLASH_START, "{}", board.name);
            let (trailer, _) = region_of(&board, "TRAILER").expect("a trailer");
            assert_eq!(trailer, start + length, "{}", board.name);
            assert!(region_of(&board, "BOOT").is_ok(), "{}", board.name);
        }
    }

    #[test]
    fn regions_are_read_in_bytes_and_kilobytes_and_others_are_none() {
        let map =
            "  FLASH : ORIGIN = 0x08000100, LENGTH = 3K /* x */\n RAM: ORIGIN = 16, LENGTH = 5\n";
        assert_eq!(region(map, "FLASH"), Some((0x0800_0100, 3072)));
        assert_eq!(region(map, "RAM"), None);
        assert_eq!(
            region(" RAM : ORIGIN = 16, LENGTH = 5", "RAM"),
            Some((16, 5))
        );
        assert_eq!(region(map, "BOOT"), None);
    }
}
