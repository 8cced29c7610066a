//! Reads an image: its sections, its symbols, and the bytes that belong into flash.

use std::fs;
use std::path::{Path, PathBuf};

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, elf};

use crate::board::Board;
use crate::error::Error;

/// Flash starts here on every STM32.
const FLASH_START: u64 = 0x0800_0000;
/// Budgets of a real board's application: flash and static RAM in bytes.
// The goal is 40 KiB; the second dialect took 8 KiB, and what of it can be won back is open (docs/firmware.md).
const FLASH_BUDGET: u64 = 48 * 1024;
const RAM_BUDGET: u64 = 8 * 1024;

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

    /// Writes the application slot as `.bin` and everything as `.hex`, beside the linked file.
    pub(crate) fn write_beside(&self, elf: &Path) -> Result<(PathBuf, PathBuf), Error> {
        let vectors = self.symbol("__vector_table")? as u32;
        let (binary, hex) = (elf.with_extension("bin"), elf.with_extension("hex"));
        write(&binary, &self.slot(vectors))?;
        write(&hex, self.intel_hex()?.as_bytes())?;
        Ok((binary, hex))
    }

    /// The bytes from the vector table on; gaps read like erased flash.
    fn slot(&self, start: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (address, contents) in &self.segments {
            if let Some(offset) = address.checked_sub(start) {
                bytes.resize(offset as usize, 0xFF);
                bytes.extend_from_slice(contents);
            }
        }
        bytes
    }

    fn intel_hex(&self) -> Result<String, Error> {
        let mut records = Vec::new();
        for (address, contents) in &self.segments {
            let mut upper = None;
            // Sixteen bytes to a record; a record never crosses a 64 K boundary, because segments start
            // at multiples of four and are cut at multiples of sixteen.
            let mut at = *address;
            let mut rest = contents.as_slice();
            while !rest.is_empty() {
                let length = (16 - (at % 16) as usize).min(rest.len());
                let (head, tail) = rest.split_at(length);
                if upper != Some(at >> 16) {
                    upper = Some(at >> 16);
                    records.push(ihex::Record::ExtendedLinearAddress((at >> 16) as u16));
                }
                records.push(ihex::Record::Data {
                    offset: at as u16,
                    value: head.to_vec(),
                });
                at += length as u32;
                rest = tail;
            }
        }
        records.push(ihex::Record::EndOfFile);
        ihex::create_object_file_representation(&records).map_err(|error| Error::Image {
            path: self.path.clone(),
            what: error.to_string(),
        })
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    fs::write(path, bytes).map_err(|cause| Error::File {
        path: path.to_owned(),
        cause,
    })
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

/// The application's slot of a board: start and length.
fn slot(board: &Board) -> Result<(u64, u64), Error> {
    let path = crate::root().join(board.map);
    let map = fs::read_to_string(&path).map_err(|cause| Error::File {
        path: path.clone(),
        cause,
    })?;
    region(&map, "FLASH").ok_or_else(|| Error::Image {
        path,
        what: "it names no region FLASH with ORIGIN and LENGTH".to_owned(),
    })
}

/// Prints sections and totals next to the budgets; an image beyond its budget is an error.
pub(crate) fn report(image: &Image, board: &Board) -> Result<(), Error> {
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
    let (start, length) = slot(board)?;
    let vectors = image.symbol("__vector_table")?;
    if vectors != start {
        return Err(Error::Image {
            path: image.path.clone(),
            what: format!("its vectors stand at {vectors:#x}, the slot of the map at {start:#x}"),
        });
    }
    let (flash, ram) = (image.flash(), image.ram());
    let stack = image.symbol("_stack_start")? - image.symbol("_stack_end")?;
    println!("flash   {flash:>6} of {FLASH_BUDGET} bytes budgeted, {length} in the slot");
    println!("RAM     {ram:>6} of {RAM_BUDGET} bytes budgeted, static");
    println!("stack   {stack:>6} bytes reserved");
    if !board.budgeted {
        println!("(the budgets are those of real boards; this image carries the plant as well)");
    } else if flash > FLASH_BUDGET || ram > RAM_BUDGET {
        return Err(Error::TooLarge {
            what: format!(
                "flash {flash} of {FLASH_BUDGET} bytes, static RAM {ram} of {RAM_BUDGET} bytes"
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
            let (start, length) = slot(&board).expect("a slot");
            // Whole pages of the update protocol, and an aligned vector table.
            assert_eq!((start % 512, length % 4096), (0, 0), "{}", board.name);
            assert!(start > FLASH_START, "{}", board.name);
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
