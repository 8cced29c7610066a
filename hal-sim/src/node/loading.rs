//! A simulated board that runs its bootloader: while its flash is busy the processor stands still, and the
//! CAN controller keeps what it has room for.

use std::collections::VecDeque;

use windlass_core::boot::loader::Loader;
use windlass_core::frame::Frame;
use windlass_core::node::{Counters, Handover, Transmission};
use windlass_core::time::Instant;

use super::memory::BoardMemory;

/// Frames that the receive FIFO of the CAN controller holds: three on bxCAN (RM0090, section 32.7.4) and on
/// the FDCAN of the G4 (RM0440, section 44.4.3). Its filters let through what the loader
/// [accepts](Loader::accepts).
const FIFO_FRAMES: usize = 3;

/// A bootloader with its receive FIFO.
#[derive(Debug)]
pub(super) struct Loading {
    pub(super) loader: Box<Loader>,
    /// The processor waits for its flash.
    stands: bool,
    fifo: VecDeque<Frame>,
    dropped: u32,
}

impl Loading {
    pub(super) const fn new(loader: Box<Loader>) -> Self {
        Self {
            loader,
            stands: false,
            fifo: VecDeque::new(),
            dropped: 0,
        }
    }

    /// A frame was received. True if the loader may have something to send or do because of it.
    pub(super) fn on_frame(
        &mut self,
        now: Instant,
        frame: &Frame,
        memory: &mut dyn BoardMemory,
    ) -> bool {
        if self.stands {
            if self.loader.accepts(frame) {
                if self.fifo.len() < FIFO_FRAMES {
                    self.fifo.push_back(*frame);
                } else {
                    self.dropped = self.dropped.wrapping_add(1);
                }
            }
            return false;
        }
        self.loader.on_frame(now, frame);
        self.stands = memory.work(now, &mut self.loader);
        true
    }

    /// The flash has finished.
    pub(super) fn go_on(&mut self, now: Instant, memory: &mut dyn BoardMemory) {
        self.stands = false;
        while !self.stands
            && let Some(frame) = self.fifo.pop_front()
        {
            self.on_frame(now, &frame, memory);
        }
    }

    pub(super) fn poll_tx(&mut self, now: Instant) -> Option<Transmission> {
        if self.stands {
            return None;
        }
        self.loader.poll_tx(now)
    }

    pub(super) fn take_reset(&mut self) -> Option<Handover> {
        if self.stands {
            return None;
        }
        self.loader.take_reset()
    }

    pub(super) fn counters(&self) -> Counters {
        Counters {
            dropped: self.dropped,
            ..*self.loader.counters()
        }
    }
}
