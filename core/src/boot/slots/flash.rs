//! One slot of flash: the pages of an image and a trailer.

use embedded_storage::nor_flash::NorFlash;

use crate::boot::image::{Hardware, PAGE_SIZE, Page, ReadPages, is_blank};

/// Bytes of the trailer.
pub const TRAILER_SIZE: usize = 4096;
/// Bytes that are read at one time.
pub(super) const CHUNK: usize = 64;
/// Largest unit of programming: a record's marker fills one.
pub(super) const LARGEST_UNIT: usize = 8;

/// Why a slot could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotError {
    /// The flash says so.
    Flash,
    /// The slot has no room for this page.
    NoRoom,
    /// What was written does not read back.
    Mismatch,
    /// The trailer has no free place.
    Full,
}

/// One slot. `F` is its own partition of flash, and nothing else can be reached through it.
///
/// Two kinds of flash are known: small erase units (at most one page; the trailer is erased on its own),
/// and one erase unit for the whole slot.
#[derive(Clone, Debug)]
pub struct Slot<F> {
    flash: F,
    room: u32,
}

/// Bytes of so many pages. Not inlined: the processor counts no bits.
#[inline(never)]
const fn bytes_of(pages: u32) -> u32 {
    pages.count_ones() * PAGE_SIZE as u32
}

impl<F: NorFlash> Slot<F> {
    const SOUND: () = assert!(
        F::WRITE_SIZE <= LARGEST_UNIT
            && LARGEST_UNIT.is_multiple_of(F::WRITE_SIZE)
            && (PAGE_SIZE.is_multiple_of(F::ERASE_SIZE) || F::ERASE_SIZE > PAGE_SIZE),
        "units of this flash do not fit pages and records"
    );

    const ERASED_WHOLE: bool = F::ERASE_SIZE > PAGE_SIZE;

    /// A slot for images of this hardware.
    #[must_use]
    pub fn new(flash: F, hardware: &Hardware) -> Self {
        let () = Self::SOUND;
        Self {
            flash,
            room: hardware.pages,
        }
    }

    /// True if a page cannot be erased without the others.
    pub(crate) const fn erased_whole(&self) -> bool {
        Self::ERASED_WHOLE
    }

    /// Pages that the slot has room for.
    #[must_use]
    pub const fn room(&self) -> u32 {
        self.room
    }

    /// Offset of a page.
    fn offset(&self, page: u8) -> Result<u32, SlotError> {
        if self.room.checked_shr(u32::from(page)).unwrap_or(0) & 1 == 0 {
            return Err(SlotError::NoRoom);
        }
        let before = self.room & !(u32::MAX << page);
        Ok(bytes_of(before))
    }

    fn trailer(&self) -> u32 {
        bytes_of(self.room)
    }

    /// Erases the trailer, and with it every page if the slot is one erase unit.
    pub(crate) fn erase_trailer(&mut self) -> Result<(), SlotError> {
        let from = if Self::ERASED_WHOLE {
            0
        } else {
            self.trailer()
        };
        let to = self.trailer() + TRAILER_SIZE as u32;
        self.flash.erase(from, to).map_err(|_| SlotError::Flash)
    }

    /// Erases one page; nothing if the slot is one erase unit.
    pub(crate) fn erase_page(&mut self, page: u8) -> Result<(), SlotError> {
        let from = self.offset(page)?;
        if Self::ERASED_WHOLE {
            return Ok(());
        }
        let to = from + PAGE_SIZE as u32;
        self.flash.erase(from, to).map_err(|_| SlotError::Flash)
    }

    /// Programs part of a page, from `offset` on. Units that stay erased are left alone.
    pub(crate) fn program(
        &mut self,
        page: u8,
        offset: usize,
        bytes: &[u8],
    ) -> Result<(), SlotError> {
        let from = self.offset(page)? + offset as u32;
        self.write(from, bytes)
    }

    fn write(&mut self, from: u32, bytes: &[u8]) -> Result<(), SlotError> {
        let unit = F::WRITE_SIZE.max(1);
        for (bytes, at) in bytes.chunks(unit).zip((from..).step_by(unit)) {
            if !is_blank(bytes) {
                self.flash.write(at, bytes).map_err(|_| SlotError::Flash)?;
            }
        }
        Ok(())
    }

    /// True if every byte of a page reads as erased.
    pub(crate) fn page_is_blank(&mut self, page: u8) -> bool {
        let mut chunk = [0; CHUNK];
        (0..PAGE_SIZE)
            .step_by(CHUNK)
            .all(|offset| self.read(page, offset, &mut chunk).is_ok() && is_blank(&chunk))
    }

    /// True if a page reads as it should.
    pub(crate) fn page_is(&mut self, page: u8, content: &Page) -> bool {
        let mut chunk = [0; CHUNK];
        content
            .chunks(CHUNK)
            .zip((0..PAGE_SIZE).step_by(CHUNK))
            .all(|(expected, offset)| {
                self.read(page, offset, &mut chunk).is_ok() && chunk == expected
            })
    }

    pub(super) fn read_trailer(&mut self, at: usize, bytes: &mut [u8]) -> Result<(), SlotError> {
        let from = self.trailer() + at as u32;
        self.flash.read(from, bytes).map_err(|_| SlotError::Flash)
    }

    pub(super) fn write_trailer(&mut self, at: usize, bytes: &[u8]) -> Result<(), SlotError> {
        let from = self.trailer() + at as u32;
        self.write(from, bytes)
    }
}

impl<F: NorFlash> ReadPages for Slot<F> {
    type Error = SlotError;

    fn read(&mut self, page: u8, offset: usize, bytes: &mut [u8]) -> Result<(), SlotError> {
        let from = self.offset(page)? + offset as u32;
        self.flash.read(from, bytes).map_err(|_| SlotError::Flash)
    }
}
