//! A bus with one other participant, at the far end of an SLCAN line.
//!
//! A frame from the client is received, a frame to the client is sent at once. While the client's
//! channel is closed nobody acknowledges, so closing it is the loss of the bus.

use core::sync::atomic::{AtomicBool, Ordering};

use windlass_core::frame::Frame;
use windlass_core::node::{Transmission, TxOutcome};
use windlass_core::slcan::{Channel, State};
use windlass_core::time::Instant;

use super::serial;
use crate::chip::stm32f405_emulated as chip;
use crate::port::{Bus, BusEvent};

/// Makes the bus deliver a frame whenever it is asked for one: more than any real bus can.
pub(super) static FLOOD: AtomicBool = AtomicBool::new(false);

/// Frames of the flood: for nobody, for another device, for this one if it has no number.
const FLOOD_FRAMES: [Frame; 3] = [
    Frame::standard(0x123, [0; 8]),
    Frame::extended(0x0206_003F, [0; 8]),
    Frame::extended(0x0206_0000, [0, 0, 0, 0, 0, 0x10, 0, 0]),
];

/// The bus.
#[derive(Debug, Default)]
pub(super) struct SlcanBus {
    channel: Channel,
    ended: Option<TxOutcome>,
    flood: usize,
}

impl Bus for SlcanBus {
    fn poll(&mut self, _: Instant) -> Option<BusEvent> {
        if let Some(outcome) = self.ended.take() {
            return Some(BusEvent::Ended(outcome));
        }
        if FLOOD.load(Ordering::Relaxed) {
            self.flood = self.flood.wrapping_add(1);
            // The client keeps its place.
            if !self.flood.is_multiple_of(8) {
                return FLOOD_FRAMES
                    .get(self.flood % FLOOD_FRAMES.len())
                    .copied()
                    .map(BusEvent::Received);
            }
        }
        while let Some(byte) = serial::can_byte() {
            let before = self.channel.state();
            let Some(answer) = self.channel.push(byte) else {
                continue;
            };
            chip::write(serial::CAN, &answer.reply);
            if let Some(frame) = answer.transmit {
                return Some(BusEvent::Received(frame));
            }
            if self.channel.state() == State::Closed && before != State::Closed {
                return Some(BusEvent::Lost);
            }
        }
        None
    }

    fn transmit(&mut self, now: Instant, transmission: &Transmission) {
        let line = self
            .channel
            .received(&transmission.frame, now.as_micros() / 1000);
        self.ended = Some(match line {
            Some(line) => {
                chip::write(serial::CAN, &line);
                TxOutcome::Sent
            }
            None => TxOutcome::Failed,
        });
    }

    /// A full queue stops the line: nothing is lost.
    fn dropped(&self) -> u32 {
        0
    }

    /// Nobody tells: the line carries frames alone.
    fn errors(&self) -> u32 {
        0
    }
}
