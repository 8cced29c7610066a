//! What happens when the program cannot go on: bridge off, cause kept, reset.

use core::arch::global_asm;
use core::panic::PanicInfo;
use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;

use crate::board;
#[cfg(not(feature = "bootloader"))]
use crate::record::hash;
use crate::record::{Cause, Record};
use crate::stack;

/// Survives a reset, at the same place for bootloader and application: `.record` is neither zeroed nor loaded.
#[unsafe(link_section = ".record")]
pub static RECORD: Record = Record::new();

/// Ends the program.
pub fn end(cause: Cause) -> ! {
    cortex_m::interrupt::disable();
    board::bridge_off();
    RECORD.set(cause);
    compiler_fence(Ordering::SeqCst);
    SCB::sys_reset();
}

/// The bootloader cannot panic: it would not link if it could, because this exists nowhere.
#[cfg(feature = "bootloader")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_is_reachable() -> !;
    }
    a_panic_is_reachable()
}

#[cfg(not(feature = "bootloader"))]
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let (line, file) = info
        .location()
        .map_or((0, 0), |place| (place.line(), hash(place.file())));
    end(Cause::Panic { line, file })
}

// The processor may have come here because the stack has overflowed: the handler starts with an empty
// stack, or its own first push would lock the processor up. Nothing of the old stack is needed.
global_asm!(
    ".section .HardFault.user, \"ax\"",
    ".global HardFault",
    ".type HardFault, %function",
    ".thumb_func",
    "HardFault:",
    "mrs r0, msp",
    "ldr r1, =_stack_start",
    "msr msp, r1",
    "b {handler}",
    ".ltorg",
    ".size HardFault, . - HardFault",
    handler = sym hard_fault,
);

/// Where the processor has put the address of the instruction, above the stack pointer (ARMv7-M Architecture Reference
/// Manual, B1.5.6).
const PUSHED_ADDRESS: u32 = 24;

extern "C" fn hard_fault(pointer: u32) -> ! {
    // SAFETY: reading this register has no side effect, and nothing else runs any more.
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    end(match stack::word(pointer.wrapping_add(PUSHED_ADDRESS)) {
        Some(address) if pointer >= stack::end() => Cause::HardFault { status, address },
        _ => Cause::StackOverflow { status, pointer },
    })
}

#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    end(Cause::UnexpectedInterrupt {
        number: number as u32,
    })
}
