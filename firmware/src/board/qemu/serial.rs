//! The two serial lines: interrupts move bytes into queues, thread mode empties them.

use core::cell::RefCell;

use critical_section::Mutex;
use heapless::Deque;
use stm32_metapac::usart::Usart;
use stm32_metapac::{USART1, USART2, interrupt};

use super::{poke, rig};
use crate::chip::stm32f405_emulated as chip;

/// The line that carries SLCAN.
pub(super) const CAN: Usart = USART1;
/// The line that carries pokes.
pub(super) const POKES: Usart = USART2;

/// Bytes of a line that thread mode has not taken yet. Enough for 18 frames; a full queue stops the
/// line, and QEMU keeps what the client sends meanwhile.
type Queue = Mutex<RefCell<Deque<u8, 512>>>;

static CAN_BYTES: Queue = Mutex::new(RefCell::new(Deque::new()));
static POKE_BYTES: Queue = Mutex::new(RefCell::new(Deque::new()));

#[interrupt]
fn USART1() {
    fill(CAN, &CAN_BYTES);
}

#[interrupt]
fn USART2() {
    fill(POKES, &POKE_BYTES);
}

fn fill(serial: Usart, queue: &Queue) {
    critical_section::with(|token| {
        let mut queue = queue.borrow_ref_mut(token);
        if let Some(byte) = chip::received(serial) {
            // There is room: the line is stopped when the last place is taken.
            let _ = queue.push_back(byte);
            if queue.is_full() {
                chip::listen(serial, false);
            }
        }
    });
}

fn next(serial: Usart, queue: &Queue) -> Option<u8> {
    critical_section::with(|token| {
        let mut queue = queue.borrow_ref_mut(token);
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

/// Passes on pokes that have come in and answers each line.
pub(super) fn take_pokes() {
    use windlass_core::slcan::{Line, LineReader};
    static READER: Mutex<RefCell<LineReader>> = Mutex::new(RefCell::new(LineReader::new()));
    while let Some(byte) = next(POKES, &POKE_BYTES) {
        let line = critical_section::with(|token| READER.borrow_ref_mut(token).push(byte));
        let Some(line) = line else { continue };
        let accepted = match &line {
            Line::Content(content) => poke::parse(content).is_some_and(rig::poke),
            Line::TooLong => false,
        };
        chip::write(POKES, if accepted { b"ok\r" } else { b"error\r" });
    }
}
