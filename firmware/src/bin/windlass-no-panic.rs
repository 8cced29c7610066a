//! Links all of the core with a panic handler that does not exist: `cargo xtask no-panic`.
//!
//! The linker script that the command adds makes every function of the core a root. If any of them can
//! reach a panic, the handler's symbol stays undefined and the image does not link.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use core::panic::PanicInfo;

// Vector table and core, which nothing else refers to.
use stm32_metapac as _;
use windlass_core as _;

unsafe extern "C" {
    safe fn a_panic_is_reachable() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_is_reachable()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
