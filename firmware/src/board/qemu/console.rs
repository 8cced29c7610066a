//! The serial line of whoever tests the board: pokes of the plant, questions, and orders to crash.

use core::cell::RefCell;
use core::sync::atomic::Ordering;

use critical_section::Mutex;
use heapless::Deque;
use stm32_metapac::usart::Usart;
use stm32_metapac::{USART2, interrupt};

use super::serial::{Queue, fill, next};
use super::{poke, rig};
use crate::chip::stm32f405_emulated as chip;
use crate::stack;

/// The line.
pub(super) const POKES: Usart = USART2;

static POKE_BYTES: Queue = Mutex::new(RefCell::new(Deque::new()));

#[interrupt]
fn USART2() {
    fill(POKES, &POKE_BYTES);
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
