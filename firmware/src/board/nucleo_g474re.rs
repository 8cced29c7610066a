//! NUCLEO-G474RE with the kit at its headers; `docs/hardware.md` has the pin table. Alternate functions are those of
//! the STM32G474 data sheet, table 13; what the board itself occupies (PA2, PA3, PA5, PA13, PA14, PB3, PC13 to PC15, PF0,
//! PF1) is told by UM2505.

use stm32_metapac::{GPIOA, GPIOB, Interrupt, interrupt};

use super::kit::{self, Chip};
use super::stm32::Description;
use crate::chip::stm32::{self as chip, Pin};
use crate::chip::stm32g4::{CLOCK_MHZ, converter};

/// Channels of the converter at [`kit::ANALOG`].
const CHANNELS: [u8; 4] = [6, 7, 8, 9];

const BOARD: Description = Chip {
    // X3 (UM2505, HSE clock).
    crystal_mhz: 24,
    bridge_mhz: CLOCK_MHZ,
    timers_mhz: CLOCK_MHZ,
    bridge_function: 6,
    // 170 periods of 5.88 ns, as (64 + 21) × 2.
    dead_time: 0x80 | 21,
    can: [Pin(GPIOA, 11), Pin(GPIOA, 12)],
    // PA2 belongs to the debug probe's serial line.
    index: Pin(GPIOB, 10),
    tick: Interrupt::TIM7_DAC,
}
.with_kit();

/// The control tick.
#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM7_DAC() {
    chip::acknowledge_tick();
    // SAFETY: this is the tick's interrupt.
    unsafe { kit::run_tick(&BOARD, converter::conversions()) };
}

/// Every switch of the bridge open, from anywhere.
#[cfg(not(feature = "bootloader"))]
pub fn bridge_off() {
    BOARD.bridge.off();
}

/// Starts the board and runs it.
#[cfg(not(feature = "bootloader"))]
pub fn run() -> ! {
    kit::run(&BOARD, || {
        // The current-sense amplifier is strong enough for a short sampling time.
        converter::start(CHANNELS, &CHANNELS[..1], None);
    })
}

/// Starts the application, or stays in the bootloader.
#[cfg(feature = "bootloader")]
pub fn boot() -> ! {
    super::stm32_boot::boot(&BOARD, || {})
}
