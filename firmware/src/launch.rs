//! From the bootloader to the application.

use cortex_m::peripheral::SCB;

use crate::memory::PAGES;

/// Starts the application by the vector table at its slot's start. To be called with the chip as a reset leaves
/// it: no interrupt is enabled.
pub fn application() -> ! {
    // SAFETY: nothing else uses the register; it takes effect with the next exception.
    unsafe { (*SCB::PTR).vtor.write(PAGES.start) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    // SAFETY: the image there is whole, so that its first two words are a stack pointer and a reset vector; one with
    // a wrong table ends in a fault or the watchdog's reset, which counts against it (docs/updates.md).
    unsafe { cortex_m::asm::bootload(core::ptr::with_exposed_provenance(PAGES.start as usize)) }
}
