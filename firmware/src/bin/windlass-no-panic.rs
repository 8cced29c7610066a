//! Links all of the core with a panic handler that does not exist: `cargo xtask no-panic`.
//!
//! The linker script that the command adds makes every function of the core a root. If any of them can
//! reach a panic, the handler's symbol stays undefined and the image does not link.
//!
//! Generic functions are no machine code until somebody uses them: `main` uses the settings journal, on a
//! memory whose contents nobody knows.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use core::hint::black_box;
use core::panic::PanicInfo;

// Vector table and core, which nothing else refers to.
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use stm32_metapac as _;
use windlass_core::params::Stored;
use windlass_core::params::journal::{Change, Journal, Key};

unsafe extern "C" {
    safe fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_is_reachable()
}

/// Flash that holds anything and may fail.
struct Anything;

impl ErrorType for Anything {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Anything {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        black_box((offset, bytes));
        black_box(Ok(()))
    }

    fn capacity(&self) -> usize {
        black_box(0)
    }
}

impl NorFlash for Anything {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 0x4000;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        black_box((from, to));
        black_box(Ok(()))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        black_box((offset, bytes));
        black_box(Ok(()))
    }
}

/// Everything that can be done with a settings journal.
fn use_journal() {
    let flash = &mut Anything;
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
    let wants = journal.wants_erase::<Anything>();
    black_box((wants, journal.has_room::<Anything>(), journal.sequence()));
}

#[cortex_m_rt::entry]
fn main() -> ! {
    use_journal();
    loop {
        cortex_m::asm::wfi();
    }
}
