//! A board with an STM32F405RG and the kit; `docs/hardware.md` has the pin table. Alternate functions are those of the
//! STM32F405 data sheet, table 9.

use stm32_metapac::{GPIOA, GPIOB, Interrupt, interrupt};

use super::kit::{self, Chip};
use super::stm32::Description;
use crate::chip::stm32::{self as chip, Pin};
use crate::chip::stm32f405::{TIMER_1_MHZ, TIMER_7_MHZ, converter};

/// Channels of the converter at [`kit::ANALOG`].
const CHANNELS: [u8; 4] = [10, 11, 12, 13];

const BOARD: Description = Chip {
    // Olimex H405 and ST's Discovery have 8 MHz, the Feather STM32F405 has 12.
    crystal_mhz: 8,
    bridge_mhz: TIMER_1_MHZ,
    timers_mhz: TIMER_7_MHZ,
    bridge_function: 1,
    // 168 periods of 5.95 ns, as (64 + 20) × 2.
    dead_time: 0x80 | 20,
    can: [Pin(GPIOB, 8), Pin(GPIOB, 9)],
    index: Pin(GPIOA, 2),
    tick: Interrupt::TIM7,
}
.with_kit();

/// The control tick.
#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn TIM7() {
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
    kit::run(&BOARD, || converter::start(CHANNELS))
}

/// Starts the application, or stays in the bootloader.
#[cfg(feature = "bootloader")]
pub fn boot() -> ! {
    super::stm32_boot::boot(&BOARD, || {})
}
