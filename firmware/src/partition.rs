//! A region of flash as a memory of its own, from whose offsets nothing else can be reached.

use core::marker::PhantomData;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// A range of addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First address.
    pub start: u32,
    /// Bytes.
    pub length: u32,
}

impl Region {
    /// This region and the one that follows it.
    ///
    /// # Panics
    /// If there is a gap between them; at compile time, because only constants are made from it.
    #[must_use]
    pub const fn with(self, next: Self) -> Self {
        assert!(
            next.start == self.start + self.length,
            "the regions do not follow each other"
        );
        Self {
            start: self.start,
            length: self.length + next.length,
        }
    }
}

/// Why the flash did not do what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The place or its length is not a multiple of the unit, or lies outside the region.
    Range,
    /// The controller has reported an error: protected, not erased before, out of sequence, failed.
    Controller,
    /// What stands there cannot be corrected: it was half written when the power failed.
    Unreadable,
    /// The chip's option bytes arrange the flash in another way than the memory map has it.
    Arrangement,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Range => NorFlashErrorKind::OutOfBounds,
            Self::Controller | Self::Unreadable | Self::Arrangement => NorFlashErrorKind::Other,
        }
    }
}

/// What a chip can do with its flash, by address. Only [`Partition`] calls it, with what it has checked.
pub trait Controller {
    /// Bytes that are programmed at one time, once after each erase.
    const WRITE_SIZE: usize;

    /// Reads bytes.
    ///
    /// # Errors
    /// [`FlashError::Unreadable`].
    fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError>;

    /// Programs one unit of [`Controller::WRITE_SIZE`] bytes.
    ///
    /// # Errors
    /// Whatever the controller reports.
    fn program(address: u32, unit: &[u8]) -> Result<(), FlashError>;

    /// Erases the unit that begins at this address.
    ///
    /// # Errors
    /// Whatever the controller reports.
    fn erase(address: u32, length: u32) -> Result<(), FlashError>;
}

/// Every erase unit of every chip begins at a multiple of this.
const SMALLEST_UNIT: u32 = 2048;

/// A region that is erased in units of `ERASE` bytes.
#[derive(Debug)]
pub struct Partition<C, const ERASE: usize> {
    region: Region,
    controller: PhantomData<C>,
}

impl<C: Controller, const ERASE: usize> Partition<C, ERASE> {
    /// The memory of a region.
    ///
    /// # Panics
    /// If the region is not made of whole erase units; at compile time, because only constants are made from it.
    #[must_use]
    pub const fn new(region: Region) -> Self {
        assert!(
            region.length > 0
                && region.start.is_multiple_of(SMALLEST_UNIT)
                && (region.length as usize).is_multiple_of(ERASE),
            "the region is not made of whole erase units"
        );
        Self {
            region,
            controller: PhantomData,
        }
    }
}

impl Region {
    /// Address of a range of offsets that lies in the region and whose ends are multiples of `unit`, a power of
    /// two.
    fn address(&self, offset: u32, length: usize, unit: usize) -> Result<u32, FlashError> {
        let length = u32::try_from(length).map_err(|_| FlashError::Range)?;
        let room = self.length.checked_sub(offset).ok_or(FlashError::Range)?;
        if length > room || (offset | length) & (unit as u32 - 1) != 0 {
            return Err(FlashError::Range);
        }
        Ok(self.start + offset)
    }

    // Once for every erase unit.
    fn write<C: Controller>(&self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let mut address = self.address(offset, bytes.len(), C::WRITE_SIZE)?;
        for unit in bytes.chunks(C::WRITE_SIZE) {
            C::program(address, unit)?;
            address += C::WRITE_SIZE as u32;
        }
        Ok(())
    }

    fn erase<C: Controller>(&self, from: u32, to: u32, unit: u32) -> Result<(), FlashError> {
        let length = to.checked_sub(from).ok_or(FlashError::Range)?;
        let mut address = self.address(from, length as usize, unit as usize)?;
        let end = address + length;
        while address < end {
            C::erase(address, unit)?;
            address += unit;
        }
        Ok(())
    }
}

impl<C, const ERASE: usize> ErrorType for Partition<C, ERASE> {
    type Error = FlashError;
}

impl<C: Controller, const ERASE: usize> ReadNorFlash for Partition<C, ERASE> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let address = self.region.address(offset, bytes.len(), 1)?;
        C::read(address, bytes)
    }

    fn capacity(&self) -> usize {
        self.region.length as usize
    }
}

impl<C: Controller, const ERASE: usize> NorFlash for Partition<C, ERASE> {
    const WRITE_SIZE: usize = C::WRITE_SIZE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.region.erase::<C>(from, to, ERASE as u32)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.region.write::<C>(offset, bytes)
    }
}

/// A memory that a chip does not have: nothing of it can be made.
#[derive(Debug)]
pub enum Missing {}

impl ErrorType for Missing {
    type Error = FlashError;
}

impl ReadNorFlash for Missing {
    const READ_SIZE: usize = 1;

    fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), FlashError> {
        match *self {}
    }

    fn capacity(&self) -> usize {
        match *self {}
    }
}

impl NorFlash for Missing {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = 2048;

    fn erase(&mut self, _: u32, _: u32) -> Result<(), FlashError> {
        match *self {}
    }

    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), FlashError> {
        match *self {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::vec::Vec;

    std::thread_local! {
        static CALLS: RefCell<Vec<(char, u32, usize)>> = const { RefCell::new(Vec::new()) };
    }

    struct Noted;

    fn note(what: char, address: u32, length: usize) {
        CALLS.with_borrow_mut(|calls| calls.push((what, address, length)));
    }

    fn noted() -> Vec<(char, u32, usize)> {
        CALLS.take()
    }

    impl Controller for Noted {
        const WRITE_SIZE: usize = 8;

        fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
            note('r', address, bytes.len());
            Ok(())
        }

        fn program(address: u32, unit: &[u8]) -> Result<(), FlashError> {
            note('p', address, unit.len());
            Ok(())
        }

        fn erase(address: u32, length: u32) -> Result<(), FlashError> {
            note('e', address, length as usize);
            Ok(())
        }
    }

    const REGION: Region = Region {
        start: 0x0800_8000,
        length: 0x1000,
    };

    fn partition() -> Partition<Noted, 2048> {
        const PARTITION: Partition<Noted, 2048> = Partition::new(REGION);
        PARTITION
    }

    #[test]
    fn offsets_become_addresses_unit_by_unit() {
        let mut flash = partition();
        assert_eq!(flash.erase(0, 0x1000), Ok(()));
        assert_eq!(
            noted(),
            [('e', 0x0800_8000, 2048), ('e', 0x0800_8800, 2048)]
        );
        assert_eq!(flash.write(0x10, &[0; 16]), Ok(()));
        assert_eq!(noted(), [('p', 0x0800_8010, 8), ('p', 0x0800_8018, 8)]);
        assert_eq!(flash.read(3, &mut [0; 5]), Ok(()));
        assert_eq!(noted(), [('r', 0x0800_8003, 5)]);
        assert_eq!(flash.capacity(), 0x1000);
    }

    #[test]
    fn nothing_outside_the_region_can_be_reached() {
        let mut flash = partition();
        for (from, to) in [
            (0, 0x1800),
            (0x1000, 0x1800),
            (0x800, 0),
            (u32::MAX - 0x7FF, u32::MAX),
            (0x800, 0xC00),
            (1, 0x801),
        ] {
            assert_eq!(flash.erase(from, to), Err(FlashError::Range));
        }
        for (offset, length) in [(0xFF8, 16), (0x1000, 8), (u32::MAX - 7, 8), (4, 8), (0, 4)] {
            assert_eq!(
                flash.write(offset, &[0; 16][..length]),
                Err(FlashError::Range)
            );
        }
        for (offset, length) in [(0xFFF, 2), (0x1000, 1), (u32::MAX, 1)] {
            assert_eq!(
                flash.read(offset, &mut [0; 2][..length]),
                Err(FlashError::Range)
            );
        }
        assert_eq!(noted(), []);
    }

    #[test]
    fn two_regions_make_one_if_they_follow_each_other() {
        let next = Region {
            start: 0x0800_9000,
            length: 0x800,
        };
        assert_eq!(REGION.with(next).length, 0x1800);
        assert!(std::panic::catch_unwind(|| next.with(REGION)).is_err());
    }
}
