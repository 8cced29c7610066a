//! Flash of the STM32G431 and STM32G474: pages of 2 KB, programmed in double words with an error correcting code.
//!
//! Section numbers are those of RM0440, chapter 3, on the STM32G474; chapter 5, on the STM32G431, has the same ones.
//!
//! An access to a bank that is erased or programmed waits, the processor's own instructions included (3.3.5). So
//! this code may stand in flash: on the STM32G431, which has one bank, nothing else runs until the controller is done;
//! on the STM32G474 settings and fallback stand in the other bank, and the control tick goes on (3.3.8). An erase
//! takes up to 25 ms a page, a double word up to 125 µs (data sheet, flash memory characteristics). The watchdog is
//! given that time before an erase.
//!
//! A double word whose programming was interrupted may not be correctable. Reading it raises a non-maskable
//! interrupt (3.3.2), which [`noted`] takes for an error of that read instead of an end of the program.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m_rt::exception;
use stm32_metapac::FLASH;

use crate::chip::stm32::{self, Patience, flash};
use crate::fault;
use crate::partition::{Controller, FlashError};
use crate::record::Cause;

/// Erase unit of the settings journal: a page in dual-bank mode (3.3.1; 5.3.1).
pub const JOURNAL_UNIT: usize = 2 * 1024;
/// Erase unit of a slot.
pub const SLOT_UNIT: usize = JOURNAL_UNIT;

/// Where flash begins (3.3.1).
const START: u32 = 0x0800_0000;
/// Errors, which are cleared by writing ones (3.7.5): OPERR, PROGERR, WRPERR, PGAERR, SIZERR, PGSERR, MISERR,
/// FASTERR, RDERR, OPTVERR.
const ERRORS: u32 = 0xC3FA;
/// Exception number of the non-maskable interrupt (ARMv7-M Architecture Reference Manual, B1.5.2).
const NON_MASKABLE: u32 = 2;
/// Bytes of a bank of the STM32G474RE with its 512 KB (3.3.1, table 6).
#[cfg(feature = "stm32g474")]
const BANK: u32 = 256 * 1024;

/// Somebody reads who can do with an error.
static READING: AtomicBool = AtomicBool::new(false);
/// What was read since then was not correctable.
static UNREADABLE: AtomicBool = AtomicBool::new(false);

/// The flash of this chip.
#[derive(Debug)]
pub struct Flash;

/// True if an uncorrectable double word has been read since this was asked last (3.7.7, ECCD and ECCD2).
fn noted() -> bool {
    let state = FLASH.eccr().read();
    // Writing ones clears the flags.
    FLASH.eccr().write_value(state);
    #[cfg(feature = "stm32g474")]
    let other = state.eccd2();
    #[cfg(not(feature = "stm32g474"))]
    let other = false;
    state.eccd() || other
}

#[exception]
unsafe fn NonMaskableInt() {
    if noted() && READING.load(Ordering::Relaxed) {
        UNREADABLE.store(true, Ordering::Relaxed);
    } else {
        // Damaged instructions, or another cause (the clock security system is not in use).
        fault::end(Cause::UnexpectedInterrupt {
            number: NON_MASKABLE,
        });
    }
}

/// Refuses a chip whose option byte DBANK makes one bank with pages of 4 KB (3.4.1): an erase would take the
/// neighbour along.
fn check_arrangement() -> Result<(), FlashError> {
    #[cfg(feature = "stm32g474")]
    if !FLASH.optr().read().dbank() {
        return Err(FlashError::Arrangement);
    }
    Ok(())
}

impl Controller for Flash {
    const WRITE_SIZE: usize = 8;

    fn read(address: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        UNREADABLE.store(false, Ordering::Relaxed);
        READING.store(true, Ordering::Relaxed);
        stm32::read_memory(address, bytes);
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        READING.store(false, Ordering::Relaxed);
        if UNREADABLE.load(Ordering::Relaxed) {
            return Err(FlashError::Unreadable);
        }
        Ok(())
    }

    /// Standard programming (3.3.7): the lower word first, nothing in between.
    fn program(address: u32, unit: &[u8]) -> Result<(), FlashError> {
        let [a, b, c, d, e, f, g, h] = *unit.first_chunk().ok_or(FlashError::Range)?;
        flash::unlock(ERRORS);
        FLASH.cr().write(|control| control.set_pg(true));
        stm32::write_memory(address, u32::from_le_bytes([a, b, c, d]));
        stm32::write_memory(address + 4, u32::from_le_bytes([e, f, g, h]));
        let programmed = flash::finish(ERRORS);
        stm32::feed_watchdog();
        programmed
    }

    /// Page erase (3.3.6).
    fn erase(address: u32, _: u32) -> Result<(), FlashError> {
        check_arrangement()?;
        let offset = address.wrapping_sub(START);
        let patience = Patience::begin();
        flash::unlock(ERRORS);
        FLASH.cr().write(|control| {
            control.set_per(true);
            #[cfg(feature = "stm32g474")]
            control.set_bker(offset >= BANK);
            #[cfg(feature = "stm32g474")]
            let offset = offset % BANK;
            control.set_pnb((offset / JOURNAL_UNIT as u32) as u8);
        });
        FLASH.cr().modify(|control| control.set_strt(true));
        let erased = flash::finish(ERRORS);
        flash::flush_caches();
        patience.end();
        erased
    }
}
