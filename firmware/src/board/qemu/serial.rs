//! Serial lines: interrupts move bytes into queues, thread mode empties them. This one carries SLCAN.

use core::cell::RefCell;

use critical_section::Mutex;
use heapless::Deque;
use stm32_metapac::usart::Usart;
use stm32_metapac::{USART1, interrupt};

use crate::chip::stm32f405_emulated as chip;

/// The line that carries SLCAN.
pub(super) const CAN: Usart = USART1;

/// Bytes of a line that thread mode has not taken yet. Enough for 18 frames; a full queue stops the
/// line, and QEMU keeps what the client sends meanwhile.
pub(super) type Queue = Mutex<RefCell<Deque<u8, 512>>>;

static CAN_BYTES: Queue = Mutex::new(RefCell::new(Deque::new()));

#[interrupt]
fn USART1() {
    fill(CAN, &CAN_BYTES);
}

/// Takes the byte that has come in on a line.
pub(super) fn fill(serial: Usart, queue: &Queue) {
    critical_section::with(|token| {
        // Nothing borrows it while interrupts are masked; without a check that could panic.
        let Ok(mut queue) = queue.borrow(token).try_borrow_mut() else {
            return;
        };
        if let Some(byte) = chip::received(serial) {
            // There is room: the line is stopped when the last place is taken.
            let _ = queue.push_back(byte);
            if queue.is_full() {
                chip::listen(serial, false);
            }
        }
    });
}

/// The next byte of a line.
pub(super) fn next(serial: Usart, queue: &Queue) -> Option<u8> {
    critical_section::with(|token| {
        let mut queue = queue.borrow(token).try_borrow_mut().ok()?;
        let was_full = queue.is_full();
        let byte = queue.pop_front();
        if was_full {
            chip::listen(serial, true);
        }
        byte
    })
}

/// The next byte of the SLCAN line.
pub(super) fn can_byte() -> Option<u8> {
    next(CAN, &CAN_BYTES)
}
