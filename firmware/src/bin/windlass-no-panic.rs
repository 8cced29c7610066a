//! Links all of the core with a panic handler that does not exist: `cargo xtask no-panic`.
//!
//! The linker script that the command adds makes every function of the core a root. If any of them can
//! reach a panic, the handler's symbol stays undefined and the image does not link.
//!
//! Generic functions are no machine code until somebody uses them: `main` uses the settings journal and the
//! bootloader, on a memory whose contents nobody knows, with small erase units and with one for all.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use core::hint::black_box;
use core::panic::PanicInfo;

// Vector table and core, which nothing else refers to.
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use stm32_metapac as _;
use windlass_core::boot::image::Hardware;
use windlass_core::boot::loader::{Loader, LoaderConfig, Memory, start};
use windlass_core::boot::slots::{Slot, Slots, Start};
use windlass_core::frame::Frame;
use windlass_core::node::{PRODUCT_DMC60C, TxOutcome};
use windlass_core::params::Stored;
use windlass_core::params::journal::{Change, Journal, Key};
use windlass_core::reset::{Crashes, ResetCause};
use windlass_core::time::Instant;

unsafe extern "C" {
    safe fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_is_reachable()
}

/// Flash that holds anything and may fail.
struct Anything<const ERASE: usize>;

impl<const ERASE: usize> ErrorType for Anything<ERASE> {
    type Error = NorFlashErrorKind;
}

impl<const ERASE: usize> ReadNorFlash for Anything<ERASE> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        black_box((offset, bytes));
        black_box(Ok(()))
    }

    fn capacity(&self) -> usize {
        black_box(0)
    }
}

impl<const ERASE: usize> NorFlash for Anything<ERASE> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        black_box((from, to));
        black_box(Ok(()))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        black_box((offset, bytes));
        black_box(Ok(()))
    }
}

/// Erase unit of the journal on an STM32F405.
const SECTOR: usize = 0x4000;

/// A bootloader from its start through all that frames can ask of it.
fn use_bootloader<const ERASE: usize>(hardware: &Hardware) {
    let mut slots = Slots {
        application: Slot::new(Anything::<ERASE>, hardware),
        fallback: black_box(Some(Slot::new(Anything::<ERASE>, hardware))),
    };
    let mut journal = Journal::open(&mut Anything::<SECTOR>);
    let mut memory = Memory {
        slots: &mut slots,
        journal: &mut journal,
        settings: &mut Anything::<SECTOR>,
    };
    let handover = black_box(None);
    let booted = start(
        &mut memory,
        &Start {
            cause: black_box(ResetCause::Watchdog),
            handover,
            crashes: black_box(Crashes::NONE),
        },
    );
    let config = LoaderConfig {
        product_id: black_box(PRODUCT_DMC60C),
        hardware: black_box(hardware.id),
        bootloader_version: black_box(0x0109),
        seed: black_box(1),
        handover,
        reason: booted.start.err().unwrap_or_default(),
    };
    let mut loader = Loader::new(&config, &mut memory);
    let now = black_box(Instant::ZERO);
    loader.on_frame(now, &black_box(Frame::extended(0x0206_FC00, [0; 8])));
    black_box(loader.work(&mut memory));
    if let Some(transmission) = black_box(loader.poll_tx(now)) {
        loader.on_transmitted(now, transmission.tag, black_box(TxOutcome::Sent));
    }
    loader.on_bus_lost();
    black_box((loader.take_reset(), loader.leds(now), loader.session()));
    let _ = black_box(slots.application.confirm());
}

/// Everything that can be done with a settings journal.
fn use_journal() {
    let flash = &mut Anything::<SECTOR>;
    let mut journal = Journal::open(flash);
    let stored = black_box(Stored::load(&journal, flash));
    let _ = black_box(journal.save(flash, &stored, black_box(false)));
    let change = Change {
        key: black_box(Key::NUMBER),
        value: black_box(None),
    };
    let _ = black_box(journal.save(flash, &change, black_box(false)));
    let _ = black_box(journal.get(flash, black_box(Key::NUMBER)));
    let _ = black_box(journal.erase_next(flash));
    let wants = journal.wants_erase::<Anything<SECTOR>>();
    black_box((
        wants,
        journal.has_room::<Anything<SECTOR>>(),
        journal.sequence(),
    ));
}

#[cortex_m_rt::entry]
fn main() -> ! {
    use_journal();
    use_bootloader::<0x2_0000>(&Hardware::F405);
    use_bootloader::<0x800>(&Hardware::G431);
    loop {
        cortex_m::asm::wfi();
    }
}
