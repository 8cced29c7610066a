//! The bootloader of all STM32 boards.

use static_cell::ConstStaticCell;
use stm32_metapac::TIM7;
use windlass_core::boot::image::{PAGE_SIZE, Page};
use windlass_core::boot::loader::{Loader, Memory};
use windlass_core::led::Leds;
use windlass_core::params::journal::Journal;
use windlass_core::time::{Duration, Instant};

use super::stm32::{Description, Panel};
use crate::bootloader::{Station, decide, stay};
use crate::chip::family;
use crate::chip::family::can::Can;
use crate::chip::stm32 as chip;
use crate::fault::{self, RECORD};
use crate::memory;
use crate::record::Cause;

/// The page buffer: static, because it would take up most of the stack, and by itself, because a loader that holds it
/// would be copied through several stack frames on its way into a static.
static PAGE: ConstStaticCell<Page> = ConstStaticCell::new([0; PAGE_SIZE]);

/// The board's part of the loader.
struct Front<'a> {
    panel: &'a Panel,
    can: Can,
    now: Instant,
    count: u16,
}

impl Station for Front<'_> {
    type Bus = Can;

    /// While the processor waits for its flash, time stands still by multiples of 65 ms.
    fn now(&mut self) -> Instant {
        let count = TIM7.cnt().read().cnt();
        let passed = count.wrapping_sub(self.count);
        self.count = count;
        self.now = self.now + Duration::from_micros(u64::from(passed));
        self.now
    }

    fn bus(&mut self) -> &mut Can {
        &mut self.can
    }

    fn show(&mut self, leds: Leds) {
        self.panel.show(leds);
    }

    fn feed_watchdog(&mut self) {
        chip::feed_watchdog();
    }
}

/// Starts the application, or stays. `prepare` sets up what the board's CAN transceiver needs besides its two pins.
#[inline]
pub(super) fn boot(board: &Description, prepare: impl FnOnce()) -> ! {
    let cause = family::take_reset_cause(&RECORD);
    family::await_supply();
    chip::start_watchdog();
    let mut settings = memory::settings();
    let mut slots = memory::slots();
    let mut journal = Journal::open(&mut settings);
    let mut memory = Memory {
        slots: &mut slots,
        journal: &mut journal,
        settings: &mut settings,
    };
    let hardware = memory::HARDWARE.id;
    let seed = chip::unique_number();
    let config = match decide(&mut memory, &RECORD, cause, hardware, seed) {
        Ok(()) => crate::launch::application(),
        Err(config) => config,
    };
    family::start_clocks(board.crystal_mhz);
    prepare();
    board.panel.start();
    chip::start_clock(board.tick_mhz);
    if let Some(page) = PAGE.try_take() {
        let [receive, transmit] = board.can;
        let mut front = Front {
            panel: &board.panel,
            can: Can::join(receive, transmit),
            now: Instant::ZERO,
            count: 0,
        };
        fault::end(Loader::run(&config, &mut memory, page, |loader, memory| {
            stay(&mut front, loader, memory)
        }));
    }
    // It is taken once: the program comes here once.
    fault::end(Cause::UnexpectedInterrupt { number: 0 })
}
