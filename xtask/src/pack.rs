//! The files that come out of a build: the sealed application, and everything that a new chip is given.

use std::fs;
use std::path::{Path, PathBuf};

use windlass_core::boot::image::{
    Hardware, Header, LAST_PAGE, PAGE_SIZE, Page, is_blank, pack, pages_of,
};
use windlass_core::boot::slots::Record;

use crate::board::Board;
use crate::error::Error;
use crate::image::{Image, region_of};

/// Generation of an image that a chip is born with.
const FIRST_GENERATION: u32 = 1;

/// Files of a board.
#[derive(Clone, Debug)]
pub(crate) struct Files {
    /// The application's slot from its first byte to the header.
    pub(crate) binary: PathBuf,
    /// The sealed application at its addresses.
    pub(crate) hex: PathBuf,
    /// Bootloader, application and its commit record at their addresses.
    pub(crate) whole: PathBuf,
    /// The whole slot with its trailer, for the emulator.
    pub(crate) slot: PathBuf,
}

impl Files {
    /// Packs the application and writes all files beside it.
    pub(crate) fn write(
        elf: &Path,
        application: &Image,
        bootloader: &Image,
        board: &Board,
    ) -> Result<Self, Error> {
        let (start, length) = region_of(board, "FLASH")?;
        let (trailer, trailer_length) = region_of(board, "TRAILER")?;
        let mut pages = flat(application.segments(), start as u32);
        let (header, last) = seal(&pages, length as usize).map_err(|what| Error::Image {
            path: elf.to_owned(),
            what,
        })?;
        pages.resize(length as usize - PAGE_SIZE, 0xFF);
        pages.extend(last);
        let committed = Record::Committed {
            generation: FIRST_GENERATION,
            image_crc: header.image_crc,
        };
        // Twice, as the bootloader writes it.
        let record = (trailer as u32, [committed.to_bytes(); 2].concat());
        let mut slot: Vec<_> = (start as u32..)
            .step_by(PAGE_SIZE)
            .zip(pages.chunks(PAGE_SIZE))
            .filter(|(_, page)| !is_blank(page))
            .map(|(at, page)| (at, page.to_vec()))
            .collect();
        let files = Self {
            binary: elf.with_extension("bin"),
            hex: elf.with_extension("hex"),
            whole: elf.with_file_name(format!(
                "windlass-{}{}.hex",
                board.name,
                if board.signed { "-signed" } else { "" }
            )),
            slot: elf.with_file_name("windlass-slot.bin"),
        };
        write(&files.binary, &pages)?;
        write(&files.hex, intel_hex(application, &slot)?.as_bytes())?;
        slot.push(record);
        let mut whole_slot = flat(&slot, start as u32);
        whole_slot.resize((length + trailer_length) as usize, 0xFF);
        write(&files.slot, &whole_slot)?;
        let mut whole = bootloader.segments().to_vec();
        whole.extend(slot);
        write(&files.whole, intel_hex(application, &whole)?.as_bytes())?;
        Ok(files)
    }
}

/// Header and page 30 of an application whose slot's first bytes are these; the slot's pages take `length` bytes, and
/// page 30 is the last of them.
fn seal(bytes: &[u8], length: usize) -> Result<(Header, Page), String> {
    let mut pages: Vec<Page> = Vec::new();
    for chunk in bytes.chunks(PAGE_SIZE) {
        let mut page = [0xFF; PAGE_SIZE];
        page.iter_mut()
            .zip(chunk)
            .for_each(|(to, from)| *to = *from);
        pages.push(page);
    }
    let mut last = [0xFF; PAGE_SIZE];
    if pages.len() == length / PAGE_SIZE {
        last = pages.pop().unwrap_or(last);
    }
    let room = Hardware::TABLE
        .into_iter()
        .find(|row| row.pages.count_ones() as usize * PAGE_SIZE == length)
        .map_or(0, |row| row.pages & !(1 << LAST_PAGE));
    let numbers: Vec<u8> = pages_of(room).collect();
    let page = |number: u8| {
        let place = numbers.iter().position(|candidate| *candidate == number)?;
        pages.get(place)
    };
    let header =
        pack(page, &mut last).map_err(|error| format!("it cannot be packed: {error:?}"))?;
    Ok((header, last))
}

/// The bytes from an address on; gaps read like erased flash.
fn flat(parts: &[(u32, Vec<u8>)], start: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (address, contents) in parts {
        if let Some(offset) = address.checked_sub(start) {
            bytes.resize(offset as usize, 0xFF);
            bytes.extend_from_slice(contents);
        }
    }
    bytes
}

fn intel_hex(image: &Image, parts: &[(u32, Vec<u8>)]) -> Result<String, Error> {
    let mut records = Vec::new();
    for (address, contents) in parts {
        let mut upper = None;
        // Sixteen bytes to a record; a record never crosses a 64 K boundary, because parts start at multiples
        // of four and are cut at multiples of sixteen.
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
        path: image.path().to_owned(),
        what: error.to_string(),
    })
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    fs::write(path, bytes).map_err(|cause| Error::File {
        path: path.to_owned(),
        cause,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_read_like_erased_flash() {
        let parts = [(0x100, vec![1, 2]), (0x104, vec![3])];
        assert_eq!(flat(&parts, 0x100), [1, 2, 0xFF, 0xFF, 3]);
    }
}
