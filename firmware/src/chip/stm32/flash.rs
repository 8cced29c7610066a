//! What the flash controllers of the families have in common (RM0090, 3; RM0440, 3): unlocking, waiting for the end
//! of an operation, caches.

use stm32_metapac::FLASH;
use stm32_metapac::flash::regs::Sr;

use crate::partition::FlashError;

/// What unlocks the control register, in this order (3.6.1; 3.3.5).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Unlocks the control register. `errors` are the controller's error flags: those that something else has left must not
/// count as this operation's, and on the STM32G4 would forbid to begin (3.3.7).
pub fn unlock(errors: u32) {
    if FLASH.cr().read().lock() {
        for key in KEYS {
            FLASH.keyr().write_value(key);
        }
    }
    FLASH.sr().write_value(Sr(errors));
}

/// Waits for the end of an operation (3.9.5, BSY; 3.7.5, BSY), locks the control register and gives the errors that the
/// operation met.
pub fn finish(errors: u32) -> Result<(), FlashError> {
    while FLASH.sr().read().bsy() {}
    let errors = FLASH.sr().read().0 & errors;
    FLASH.sr().write_value(Sr(errors));
    FLASH.cr().write(|control| control.set_lock(true));
    if errors == 0 {
        Ok(())
    } else {
        Err(FlashError::Controller)
    }
}

/// Forgets what the caches hold: an erase does not reach them (3.5.2, 3.6.3; 3.3.4).
pub fn flush_caches() {
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
