//! Flash of the STM32F405 (RM0090, 3): sectors of 16, 64 and 128 KB, programmed in words.
//!
//! There is one bank: while it is erased or programmed, every access to it waits, the processor's own
//! instructions included (3.6). So this code may stand in flash, and nothing else runs until the controller is
//! done: an erase of 128 KB takes up to 2 s, of 16 KB up to 500 ms, a word up to 100 µs (data sheet, table 40).
//! The watchdog is given that time before an erase.

use stm32_metapac::FLASH;
use stm32_metapac::flash::vals::Psize;

use crate::chip::stm32::{self, Patience, flash};
use crate::partition::{Controller, FlashError};

/// Erase unit of the settings journal: sectors 2 and 3 (3.3, table 5).
pub const JOURNAL_UNIT: usize = 16 * 1024;
/// Erase unit of a slot: sector 5, sector 6.
pub const SLOT_UNIT: usize = 128 * 1024;

/// Where flash begins (3.3, table 5).
const START: u32 = 0x0800_0000;
/// Errors, which are cleared by writing ones (3.9.5): OPERR, WRPERR, PGAERR, PGPERR, PGSERR.
const ERRORS: u32 = 0xF2;
/// Four bytes at a time, which takes a supply of 2.7 to 3.6 V (3.6.2, table 12): the supply detector stands at
/// 2.8 V.
const PARALLELISM: Psize = Psize::PSIZE32;

/// The sector that begins at this address and is as long as this (3.3, table 5).
const fn sector(address: u32, length: u32) -> Option<u8> {
    const K: u32 = 1024;
    let offset = address.wrapping_sub(START);
    let number = match (offset / K, length / K) {
        (at @ 0..64, 16) => at / 16,
        (64, 64) => 4,
        (at @ 128..1024, 128) => 4 + at / 128,
        _ => return None,
    };
    Some(number as u8)
}

const _: () = {
    assert!(matches!(sector(0x0800_C000, 16 * 1024), Some(3)));
    assert!(matches!(sector(0x0802_0000, 128 * 1024), Some(5)));
    assert!(matches!(sector(0x0804_0000, 128 * 1024), Some(6)));
    assert!(sector(0x0804_0000, 16 * 1024).is_none());
};

/// The flash of this chip.
#[derive(Debug)]
pub struct Flash;

impl Controller for Flash {
    const WRITE_SIZE: usize = 4;

    fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        stm32::read_memory(address, bytes);
        Ok(())
    }

    /// Word programming (3.6.4).
    fn program(address: u32, unit: &[u8]) -> Result<(), FlashError> {
        let word = unit.first_chunk().ok_or(FlashError::Range)?;
        flash::unlock(ERRORS);
        FLASH.cr().write(|control| {
            control.set_psize(PARALLELISM);
            control.set_pg(true);
        });
        stm32::write_memory(address, u32::from_le_bytes(*word));
        let programmed = flash::finish(ERRORS);
        stm32::feed_watchdog();
        programmed
    }

    /// Sector erase (3.6.3).
    fn erase(address: u32, length: u32) -> Result<(), FlashError> {
        let number = sector(address, length).ok_or(FlashError::Range)?;
        let patience = Patience::begin();
        flash::unlock(ERRORS);
        FLASH.cr().write(|control| {
            control.set_psize(PARALLELISM);
            control.set_ser(true);
            control.set_snb(number);
        });
        FLASH.cr().modify(|control| control.set_strt(true));
        let erased = flash::finish(ERRORS);
        flash::flush_caches();
        patience.end();
        erased
    }
}
