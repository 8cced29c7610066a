//! The bootloader of the emulated board.

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use static_cell::ConstStaticCell;
use stm32_metapac::Interrupt;
use windlass_core::boot::image::{PAGE_SIZE, Page};
use windlass_core::boot::loader::{Loader, Memory};
use windlass_core::led::Leds;
use windlass_core::params::journal::Journal;
use windlass_core::reset::ResetCause;
use windlass_core::time::{Instant, TICK};

use super::SEED;
use super::bus::SlcanBus;
use super::serial;
use crate::bootloader::{Station, decide, stay};
use crate::chip::stm32f405_emulated as chip;
use crate::fault::{self, RECORD};
use crate::memory;
use crate::record::Cause;

/// The page buffer: static, because it would take up most of the stack, and by itself, because a loader that holds it
/// would be copied through several stack frames on its way into a static.
static PAGE: ConstStaticCell<Page> = ConstStaticCell::new([0; PAGE_SIZE]);

/// Vectors of the first interrupts, up to that of USART1 (RM0090, table 62). The linker puts them behind the exceptions.
#[used]
#[unsafe(link_section = ".vector_table.bus")]
static VECTORS: [unsafe extern "C" fn(); 38] = {
    unsafe extern "C" {
        fn DefaultHandler();
        fn USART1();
    }
    let mut vectors = [DefaultHandler as unsafe extern "C" fn(); 38];
    vectors[Interrupt::USART1 as usize] = USART1;
    vectors
};

/// The board's part of the loader.
struct Front {
    bus: SlcanBus,
    timer: SYST,
    now: Instant,
}

impl Station for Front {
    type Bus = SlcanBus;

    fn now(&mut self) -> Instant {
        if chip::tick_has_passed(&mut self.timer) {
            self.now = self.now + TICK;
        }
        self.now
    }

    fn bus(&mut self) -> &mut SlcanBus {
        &mut self.bus
    }

    fn show(&mut self, _: Leds) {}

    fn feed_watchdog(&mut self) {}
}

/// Starts the application, or stays in the bootloader.
pub fn boot() -> ! {
    if !RECORD.survived() {
        chip::flash::power_on(memory::SLOT, memory::JOURNAL, memory::FACTORY);
    }
    let mut settings = memory::settings();
    let mut slots = memory::slots();
    let mut journal = Journal::open(&mut settings);
    let mut memory = Memory {
        slots: &mut slots,
        journal: &mut journal,
        settings: &mut settings,
    };
    let hardware = memory::HARDWARE.id;
    // The emulated chip has no reset flags: the record alone decides.
    let config = match decide(&mut memory, &RECORD, ResetCause::Unknown, hardware, SEED) {
        Ok(()) => crate::launch::application(),
        Err(config) => config,
    };
    if let Some(mut core) = Peripherals::take()
        && let Some(page) = PAGE.try_take()
    {
        chip::start_serial(&mut core.NVIC, serial::CAN, Interrupt::USART1);
        chip::start_clock(&mut core.SYST);
        let mut front = Front {
            bus: SlcanBus::default(),
            timer: core.SYST,
            now: Instant::ZERO,
        };
        fault::end(Loader::run(&config, &mut memory, page, |loader, memory| {
            stay(&mut front, loader, memory)
        }));
    }
    // Both are taken once: the program comes here once.
    fault::end(Cause::UnexpectedInterrupt { number: 0 })
}
