//! Between a CAN controller's interrupts and thread mode: frames that came, and the one that goes.
//!
//! What the controller reports is told to a [`Mailbox`] by interrupts; thread mode empties it. Nothing is
//! parsed here. A bootloader enables no interrupt and asks its controller in each pass: it has a [`Line`] instead.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use critical_section::Mutex;
use heapless::Deque;
use windlass_core::frame::Frame;
use windlass_core::node::{Attempts, TxOutcome};

use crate::latest::{Latest, Maybe};
use crate::port::BusEvent;

/// Frames that may wait for thread mode: 1.5 ms of a saturated bus of 1 Mbit/s.
const WAITING: usize = 32;

/// How an attempt to send has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// Sent and acknowledged.
    Sent,
    /// An error frame has destroyed it.
    Destroyed,
    /// Lost arbitration, which is only waiting, or nobody acknowledged, which ends with the loss of the bus:
    /// no attempt in the sense of [`Attempts`].
    Waiting,
}

impl Attempt {
    /// What follows: another attempt, with so many left, or the end of the transmission.
    ///
    /// # Errors
    /// The transmission has ended like this.
    const fn then(self, left: Attempts) -> Result<Attempts, TxOutcome> {
        match (self, left) {
            (Self::Sent, _) => Err(TxOutcome::Sent),
            (Self::Destroyed, Attempts::AtMost(0 | 1)) => Err(TxOutcome::Failed),
            (Self::Destroyed, Attempts::AtMost(left)) => Ok(Attempts::AtMost(left - 1)),
            (_, left) => Ok(left),
        }
    }
}

/// The transmission of a controller that repeats nothing by itself and that no interrupt serves.
#[derive(Debug, Default)]
pub struct Line {
    on_the_way: Option<Attempts>,
}

impl Line {
    /// A transmission starts.
    pub const fn start(&mut self, attempts: Attempts) {
        self.on_the_way = Some(attempts);
    }

    /// The bus is lost: what is on its way is given up without an outcome.
    pub const fn flush(&mut self) {
        self.on_the_way = None;
    }

    /// The next event: the end of a transmission before a frame. `attempt` is how an attempt has ended, if one has,
    /// `repeat` starts another one.
    pub fn poll(
        &mut self,
        attempt: Option<Attempt>,
        repeat: impl FnOnce(),
        received: impl FnOnce() -> Option<Frame>,
    ) -> Option<BusEvent> {
        if let (Some(attempt), Some(left)) = (attempt, self.on_the_way) {
            match attempt.then(left) {
                Ok(left) => {
                    self.on_the_way = Some(left);
                    repeat();
                }
                Err(outcome) => {
                    self.on_the_way = None;
                    return Some(BusEvent::Ended(outcome));
                }
            }
        }
        received().map(BusEvent::Received)
    }
}

/// The mailbox of one controller, which repeats nothing by itself.
#[derive(Debug)]
pub struct Mailbox {
    received: Mutex<RefCell<Deque<Frame, WAITING>>>,
    /// Frames that found no place, here or in the controller.
    dropped: AtomicU32,
    /// Error frames that the controller has seen.
    errors: AtomicU32,
    /// How often the transmission on its way may still be destroyed.
    on_the_way: Latest<Maybe<Attempts>>,
    /// How the latest transmission ended.
    ended: Latest<Maybe<TxOutcome>>,
}

/// Only the controller's interrupts count, which do not interrupt each other.
fn count_up(counter: &AtomicU32) {
    let count = counter.load(Ordering::Relaxed);
    counter.store(count.wrapping_add(1), Ordering::Relaxed);
}

impl Mailbox {
    /// An empty mailbox.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            received: Mutex::new(RefCell::new(Deque::new())),
            dropped: AtomicU32::new(0),
            errors: AtomicU32::new(0),
            on_the_way: Latest::empty(),
            ended: Latest::empty(),
        }
    }

    /// A frame was received; it is dropped and counted if there is no place.
    pub fn receive(&self, frame: Frame) {
        // Nothing borrows it while interrupts are masked; without a check that could panic.
        let kept = critical_section::with(|token| {
            let received = self.received.borrow(token).try_borrow_mut();
            received.is_ok_and(|mut received| received.push_back(frame).is_ok())
        });
        if !kept {
            self.count_drop();
        }
    }

    /// The controller has lost a frame.
    pub fn count_drop(&self) {
        count_up(&self.dropped);
    }

    /// The controller has seen an error frame, its own or another's.
    pub fn count_error(&self) {
        count_up(&self.errors);
    }

    /// Error frames since power-on; wraps.
    pub fn errors(&self) -> u32 {
        self.errors.load(Ordering::Relaxed)
    }

    /// Frames lost since power-on; wraps.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// A transmission starts.
    pub fn start(&self, attempts: Attempts) {
        self.on_the_way.offer(attempts);
    }

    /// An attempt has ended; true if it is to be repeated.
    pub fn ended(&self, attempt: Attempt) -> bool {
        let Some(attempts) = self.on_the_way.get().get() else {
            return false;
        };
        match attempt.then(attempts) {
            Ok(left) => {
                self.on_the_way.offer(left);
                true
            }
            Err(outcome) => {
                self.on_the_way.put(Maybe::Nothing);
                self.ended.offer(outcome);
                false
            }
        }
    }

    /// The bus is lost: what is on its way is given up without an outcome.
    pub fn flush(&self) {
        self.on_the_way.put(Maybe::Nothing);
        self.ended.put(Maybe::Nothing);
    }

    /// The next event for thread mode: the end of a transmission before frames.
    pub fn poll(&self) -> Option<BusEvent> {
        if let Some(outcome) = self.ended.take() {
            return Some(BusEvent::Ended(outcome));
        }
        critical_section::with(|token| {
            let mut received = self.received.borrow(token).try_borrow_mut().ok()?;
            received.pop_front()
        })
        .map(BusEvent::Received)
    }
}

impl Default for Mailbox {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_in_order_and_those_without_a_place_are_counted() {
        let mailbox = Mailbox::new();
        for at in 0..WAITING as u16 + 3 {
            mailbox.receive(Frame::standard(at, []));
        }
        assert_eq!(mailbox.dropped(), 3);
        for at in 0..WAITING as u16 {
            let expected = BusEvent::Received(Frame::standard(at, []));
            assert_eq!(mailbox.poll(), Some(expected));
        }
        assert_eq!(mailbox.poll(), None);
    }

    #[test]
    fn only_destroyed_attempts_count_against_the_limit() {
        let mailbox = Mailbox::new();
        mailbox.start(Attempts::AtMost(2));
        assert!(mailbox.ended(Attempt::Waiting));
        assert!(mailbox.ended(Attempt::Destroyed));
        assert!(mailbox.ended(Attempt::Waiting));
        assert!(!mailbox.ended(Attempt::Destroyed));
        assert_eq!(mailbox.poll(), Some(BusEvent::Ended(TxOutcome::Failed)));
        mailbox.start(Attempts::UntilSent);
        for _ in 0..1000 {
            assert!(mailbox.ended(Attempt::Destroyed));
        }
        assert!(!mailbox.ended(Attempt::Sent));
        assert_eq!(mailbox.poll(), Some(BusEvent::Ended(TxOutcome::Sent)));
    }

    #[test]
    fn a_line_without_interrupts_counts_attempts_in_the_same_way() {
        let mut line = Line::default();
        let mut repeated = 0;
        let mut poll = |line: &mut Line, attempt| line.poll(attempt, || repeated += 1, || None);
        line.start(Attempts::AtMost(2));
        assert_eq!(poll(&mut line, None), None);
        assert_eq!(poll(&mut line, Some(Attempt::Waiting)), None);
        assert_eq!(poll(&mut line, Some(Attempt::Destroyed)), None);
        assert_eq!(
            poll(&mut line, Some(Attempt::Destroyed)),
            Some(BusEvent::Ended(TxOutcome::Failed))
        );
        line.start(Attempts::UntilSent);
        for _ in 0..1000 {
            assert_eq!(poll(&mut line, Some(Attempt::Destroyed)), None);
        }
        assert_eq!(
            poll(&mut line, Some(Attempt::Sent)),
            Some(BusEvent::Ended(TxOutcome::Sent))
        );
        // What ends later was given up.
        line.start(Attempts::UntilSent);
        line.flush();
        assert_eq!(poll(&mut line, Some(Attempt::Destroyed)), None);
        assert_eq!(repeated, 1002);
        let frame = Frame::standard(1, []);
        assert_eq!(
            line.poll(None, || (), || Some(frame)),
            Some(BusEvent::Received(frame))
        );
    }

    #[test]
    fn after_a_flush_nothing_is_repeated_or_reported() {
        let mailbox = Mailbox::new();
        mailbox.start(Attempts::UntilSent);
        mailbox.flush();
        assert!(!mailbox.ended(Attempt::Destroyed));
        assert_eq!(mailbox.poll(), None);
    }
}
