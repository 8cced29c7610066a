//! Bytes in flash: cells, headers of units and sets, and finding sets among what cuts have left.
//!
//! Everything is aligned to cells of eight bytes, so that one layout serves memories that are programmed
//! by 2, 4 or 8 bytes. `docs/settings.md` draws it and argues why no cut can hurt.

use embedded_storage::nor_flash::NorFlash;

use crate::crc::Crc32;

/// Bytes of a cell.
pub(super) const CELL: u32 = 8;

/// Begins a set. The same in every format and for ever: a cell that an interrupted save has touched, but
/// that reads as erased, is programmed again with what it was to become. Five zeros in a row occur in
/// no entry of parameters, identity or faults.
const MAGIC: [u8; 8] = [0, 0, 0, 0, 0, b'W', b'L', b'J'];

/// Programmed once everything before it is complete.
pub(super) const SEAL: [u8; 8] = *b"complete";

/// A cell that nothing was programmed into.
pub(super) const ERASED: [u8; 8] = [0xFF; 8];

/// Bytes at the start of an erase unit before the first set: generation and seal.
pub(super) const UNIT_HEADER: u32 = 2 * CELL;

/// Bytes of a set before its entries.
pub(super) const SET_HEADER: u32 = 3 * CELL;

/// Bytes of a set beside its entries.
pub(super) const SET_FRAME: u32 = SET_HEADER + CELL;

/// A set as its header tells, and where it was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Set {
    /// Address of its first byte.
    pub(super) address: u32,
    /// Version of the entries' encoding.
    pub(super) format: u16,
    /// Bytes of the entries.
    pub(super) length: u16,
    /// Generation of the erase unit it was written into.
    pub(super) generation: u32,
    /// Number of the save.
    pub(super) sequence: u32,
    /// CRC-32/ISO-HDLC over the entries, then address, length, format, generation and sequence.
    pub(super) crc: u32,
}

impl Set {
    /// Bytes that a set with `length` bytes of entries takes up.
    pub(super) const fn extent_of(length: u16) -> u32 {
        SET_FRAME + (length as u32).next_multiple_of(CELL)
    }

    /// First address after the set.
    pub(super) const fn end(&self) -> u32 {
        self.address + Self::extent_of(self.length)
    }

    /// Address of the entries.
    pub(super) const fn entries(&self) -> u32 {
        self.address + SET_HEADER
    }

    const fn seal(&self) -> u32 {
        self.end() - CELL
    }

    /// The second cell of the header.
    const fn shape(&self) -> [u8; 8] {
        let [a, b] = self.length.to_le_bytes();
        let [c, d] = self.format.to_le_bytes();
        let [e, f, g, h] = self.generation.to_le_bytes();
        [a, b, c, d, e, f, g, h]
    }

    /// Ends the CRC that has taken the entries.
    pub(super) fn finish_crc(&self, mut entries: Crc32) -> u32 {
        let (address, sequence) = (self.address.to_le_bytes(), self.sequence.to_le_bytes());
        for part in [&address[..], &self.shape(), &sequence] {
            entries.update(part);
        }
        entries.finish()
    }

    /// Programs the first cell.
    pub(super) fn write_magic<F: NorFlash>(&self, flash: &mut F) -> Result<(), F::Error> {
        flash.write(self.address, &MAGIC)
    }

    /// Programs the rest of the header.
    pub(super) fn write_header<F: NorFlash>(&self, flash: &mut F) -> Result<(), F::Error> {
        let [a, b, c, d] = self.sequence.to_le_bytes();
        let [e, f, g, h] = self.crc.to_le_bytes();
        flash.write(self.address + CELL, &self.shape())?;
        flash.write(self.address + 2 * CELL, &[a, b, c, d, e, f, g, h])
    }

    /// Reads the header at `address`; `None` if no set that would end by `limit` begins there.
    fn read_header<F: NorFlash>(flash: &mut F, address: u32, limit: u32) -> Option<Self> {
        let [a, b, c, d, e, f, g, h] = read_cell(flash, address + CELL)?;
        let [i, j, k, l, m, n, o, p] = read_cell(flash, address + 2 * CELL)?;
        let set = Self {
            address,
            length: u16::from_le_bytes([a, b]),
            format: u16::from_le_bytes([c, d]),
            generation: u32::from_le_bytes([e, f, g, h]),
            sequence: u32::from_le_bytes([i, j, k, l]),
            crc: u32::from_le_bytes([m, n, o, p]),
        };
        (set.end() <= limit).then_some(set)
    }

    /// True if the entries are those that the header was made for.
    pub(super) fn is_whole<F: NorFlash>(&self, flash: &mut F) -> bool {
        let mut crc = Crc32::new();
        let mut left = usize::from(self.length);
        let mut at = self.entries();
        while left > 0 {
            let Some(cell) = read_cell(flash, at) else {
                return false;
            };
            crc.update(cell.get(..left.min(cell.len())).unwrap_or(&cell));
            left = left.saturating_sub(cell.len());
            at += CELL;
        }
        self.finish_crc(crc) == self.crc
    }

    /// True if the whole set is found where it was written, but for its seal.
    pub(super) fn reads_back<F: NorFlash>(&self, flash: &mut F) -> bool {
        read_cell(flash, self.address) == Some(MAGIC)
            && Self::read_header(flash, self.address, self.end()) == Some(*self)
            && self.is_whole(flash)
    }

    /// True if the set was completed: its bits are stable.
    pub(super) fn is_sealed<F: NorFlash>(&self, flash: &mut F) -> bool {
        read_cell(flash, self.seal()) == Some(SEAL)
    }

    /// Programs the seal.
    pub(super) fn write_seal<F: NorFlash>(&self, flash: &mut F) -> Result<(), F::Error> {
        flash.write(self.seal(), &SEAL)
    }

    /// True if this set was written after `other`.
    const fn is_newer_than(&self, other: &Self) -> bool {
        self.generation > other.generation
            || self.generation == other.generation && self.address > other.address
    }
}

/// The newer one of two sets.
pub(super) fn newer(a: Option<Set>, b: Option<Set>) -> Option<Set> {
    match (a, b) {
        (Some(a), Some(b)) if a.is_newer_than(&b) => Some(a),
        (a, b) => b.or(a),
    }
}

/// One cell; `None` if it can not be read.
pub(super) fn read_cell<F: NorFlash>(flash: &mut F, address: u32) -> Option<[u8; 8]> {
    let mut cell = [0; 8];
    flash.read(address, &mut cell).ok()?;
    Some(cell)
}

/// The first cell of an erase unit that was erased for `generation`.
pub(super) const fn generation_cell(generation: u32) -> [u8; 8] {
    let [a, b, c, d] = generation.to_le_bytes();
    let [e, f, g, h] = (!generation).to_le_bytes();
    [a, b, c, d, e, f, g, h]
}

/// What is in one erase unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contents {
    /// The newest whole set.
    pub(super) newest: Option<Set>,
    /// First address that is untouched for all that can be read.
    pub(super) end: u32,
}

impl Contents {
    /// Looks through the unit from `start` to `limit`.
    ///
    /// Every cell may begin a set, because what a cut has left tells nothing reliable about its length;
    /// a whole set is passed over, so that nothing inside it is taken for another one.
    pub(super) fn read<F: NorFlash>(flash: &mut F, start: u32, limit: u32) -> Self {
        let mut at = start + UNIT_HEADER;
        let mut contents = Self {
            newest: None,
            end: at,
        };
        while at < limit {
            let cell = read_cell(flash, at);
            let mut next = at + CELL;
            if cell != Some(ERASED) {
                contents.end = contents.end.max(next);
            }
            if cell == Some(MAGIC) {
                // An interrupted save may have touched cells that read as erased: those of the header,
                // and if it is whole, those that it announces.
                contents.end = contents.end.max(at + SET_FRAME);
                if let Some(set) = Set::read_header(flash, at, limit) {
                    contents.end = contents.end.max(set.end());
                    if set.is_whole(flash) {
                        contents.newest = newer(contents.newest, Some(set));
                        next = set.end();
                    }
                }
            }
            at = next;
        }
        contents
    }
}
