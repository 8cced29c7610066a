//! Flash of the STM32F405 (RM0090, 3): sectors of 16, 64 and 128 KB, programmed in words.
//!
//! There is one bank: while it is erased or programmed, every access to it waits, the processor's own
//! instructions included (3.6). So this code may stand in flash, and nothing else runs until the controller is
//! done: an erase of 128 KB takes up to 2 s, of 16 KB up to 500 ms, a word up to 100 µs (data sheet, table 40).
//! The watchdog is given that time before an erase.

use stm32_metapac::FLASH;
use stm32_metapac::flash::regs::Sr;
use stm32_metapac::flash::vals::Psize;

use crate::chip::stm32::{self, Patience};
use crate::partition::{Controller, FlashError};

/// Erase unit of the settings journal: sectors 2 and 3 (3.3, table 5).
pub const JOURNAL_UNIT: usize = 16 * 1024;
/// Erase unit of a slot: sector 5, sector 6.
pub const SLOT_UNIT: usize = 128 * 1024;

/// Where flash begins (3.3, table 5).
const START: u32 = 0x0800_0000;
/// What unlocks the control register, in this order (3.6.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
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

/// Waits for the end of an operation (3.9.5, BSY) and gives the errors that it met.
fn finish() -> Result<(), FlashError> {
    while FLASH.sr().read().bsy() {}
    let errors = FLASH.sr().read().0 & ERRORS;
    FLASH.sr().write_value(Sr(errors));
    if errors == 0 {
        Ok(())
    } else {
        Err(FlashError::Controller)
    }
}

fn unlock() {
    if FLASH.cr().read().lock() {
        for key in KEYS {
            FLASH.keyr().write_value(key);
        }
    }
    // Errors that something else has left must not count as this operation's.
    FLASH.sr().write_value(Sr(ERRORS));
}

fn lock() {
    FLASH.cr().write(|control| control.set_lock(true));
}

/// Forgets what the caches hold: an erase does not reach them (3.5.2, 3.6.3).
fn flush_caches() {
    FLASH.acr().modify(|access| {
        access.set_dcen(false);
        access.set_icen(false);
    });
    let resets = |on: bool| {
        FLASH.acr().modify(|access| {
            access.set_dcrst(on);
            access.set_icrst(on);
        });
    };
    resets(true);
    resets(false);
    FLASH.acr().modify(|access| {
        access.set_dcen(true);
        access.set_icen(true);
    });
}

impl Controller for Flash {
    const WRITE_SIZE: usize = 4;

    fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        stm32::read_memory(address, bytes);
        Ok(())
    }

    /// Word programming (3.6.4).
    fn program(address: u32, unit: &[u8]) -> Result<(), FlashError> {
        let word = unit.first_chunk().ok_or(FlashError::Range)?;
        unlock();
        FLASH.cr().write(|control| {
            control.set_psize(PARALLELISM);
            control.set_pg(true);
        });
        stm32::write_memory(address, u32::from_le_bytes(*word));
        let programmed = finish();
        lock();
        stm32::feed_watchdog();
        programmed
    }

    /// Sector erase (3.6.3).
    fn erase(address: u32, length: u32) -> Result<(), FlashError> {
        let number = sector(address, length).ok_or(FlashError::Range)?;
        let patience = Patience::begin();
        unlock();
        FLASH.cr().write(|control| {
            control.set_psize(PARALLELISM);
            control.set_ser(true);
            control.set_snb(number);
        });
        FLASH.cr().modify(|control| control.set_strt(true));
        let erased = finish();
        lock();
        flush_caches();
        patience.end();
        erased
    }
}
