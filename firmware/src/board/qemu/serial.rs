//! The two serial lines: interrupts move bytes into queues, thread mode empties them.

use core::cell::RefCell;
use core::sync::atomic::Ordering;

use critical_section::Mutex;
use heapless::Deque;
use stm32_metapac::usart::Usart;
use stm32_metapac::{USART1, USART2, interrupt};

use super::{poke, rig};
use crate::chip::stm32f405_emulated as chip;
use crate::stack;

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
        if let Line::Content(content) = &line {
            crash(content);
        }
        let answer: &[u8] = match &line {
            Line::Content(content) if content == b"stack" => &number(stack::high_water()),
            Line::Content(content) if content == b"flood" => {
                super::bus::FLOOD.store(true, Ordering::Relaxed);
                b"ok\r"
            }
            Line::Content(content) if content == b"jitter" => {
                &number(super::JITTER.spread() as usize)
            }
            Line::Content(content) if poke::parse(content).is_some_and(rig::poke) => b"ok\r",
            _ => b"error\r",
        };
        chip::write(POKES, answer);
    }
}

/// Ends the program in the way that is asked for, so that a test can see what is left of it.
fn crash(how: &[u8]) {
    match how {
        b"crash panic" => panic!("asked for"),
        b"crash fault" => cortex_m::asm::udf(),
        b"crash interrupt" => chip::interrupt_without_handler(),
        b"crash stack" => chip::overflow_stack(stack::end()),
        _ => {}
    }
}

/// A number as a line of five digits.
fn number(mut rest: usize) -> [u8; 6] {
    let mut text = *b"00000\r";
    for digit in text.iter_mut().take(5).rev() {
        *digit = b'0' + (rest % 10) as u8;
        rest /= 10;
    }
    text
}
