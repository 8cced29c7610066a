//! RAM that behaves like the STM32F405's flash, for an emulator that has no flash controller: words, each programmed
//! once after an erase; one erase unit for the whole slot. It takes no time, and it does not survive the emulator.

use core::ptr;

#[cfg(feature = "bootloader")]
use crate::partition::Region;
use crate::partition::{Controller, FlashError};

/// Erase unit of the settings journal.
pub const JOURNAL_UNIT: usize = 8 * 1024;
/// Erase unit of a slot, as on the chip.
pub const SLOT_UNIT: usize = 128 * 1024;

/// What erased flash reads as.
const ERASED: u32 = 0xFFFF_FFFF;

/// The flash of this chip.
#[derive(Debug)]
pub struct Flash;

fn read(address: u32) -> u32 {
    // SAFETY: a partition or a region of the map has been given: aligned RAM or ROM, and no object of this program.
    unsafe { ptr::with_exposed_provenance::<u32>(address as usize).read_volatile() }
}

fn write(address: u32, word: u32) {
    // SAFETY: as in `read`; only RAM is written.
    unsafe { ptr::with_exposed_provenance_mut::<u32>(address as usize).write_volatile(word) };
}

impl Controller for Flash {
    const WRITE_SIZE: usize = 4;

    fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        for (at, byte) in (address..).zip(bytes) {
            *byte = (read(at & !3) >> (8 * (at % 4))) as u8;
        }
        Ok(())
    }

    fn program(address: u32, unit: &[u8]) -> Result<(), FlashError> {
        let word = unit.first_chunk().ok_or(FlashError::Range)?;
        if read(address) != ERASED {
            return Err(FlashError::Controller);
        }
        write(address, u32::from_le_bytes(*word));
        Ok(())
    }

    fn erase(address: u32, length: u32) -> Result<(), FlashError> {
        for at in (address..address + length).step_by(4) {
            write(at, ERASED);
        }
        Ok(())
    }
}

/// Power-on: the slot holds what the emulator has loaded into `factory`, if anything, and the journal is erased.
#[cfg(feature = "bootloader")]
pub fn power_on(slot: Region, settings: Region, factory: Region) {
    let loaded = read(factory.start) != 0;
    for offset in (0..slot.length).step_by(4) {
        let word = if loaded {
            read(factory.start + offset)
        } else {
            ERASED
        };
        write(slot.start + offset, word);
    }
    for at in (settings.start..settings.start + settings.length).step_by(4) {
        write(at, ERASED);
    }
}
