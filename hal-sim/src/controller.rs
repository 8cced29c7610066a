//! One CAN controller: transmit mailbox, error counters, error passive, bus-off (ISO 11898-1:2015,
//! clause 12, "fault confinement").

use std::collections::VecDeque;

use windlass_core::frame::Frame;

use crate::bits::Shape;

/// From this count on a controller is error passive.
const PASSIVE_FROM: u16 = 128;
/// From this transmit error count on a controller is bus-off.
const BUS_OFF_FROM: u16 = 256;
/// Receive error count after a good reception of an error-passive receiver (the standard allows 119 to
/// 127).
const REC_AFTER_PASSIVE: u16 = 119;
/// Sequences of 11 recessive bits that end bus-off.
pub(crate) const RECOVERY_SEQUENCES: u32 = 128;
/// No point in time.
pub(crate) const NEVER: u64 = u64::MAX;

/// How a controller takes part in the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum ErrorState {
    /// Error active: takes part without restriction.
    #[default]
    Active,
    /// Error passive: a counter has reached 128; waits 8 bits more between its own frames.
    Passive,
    /// Bus-off: the transmit error counter has reached 256; neither sends nor receives.
    BusOff,
}

impl ErrorState {
    /// The state's name: "error-active", "error-passive", "bus-off".
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Active => "error-active",
            Self::Passive => "error-passive",
            Self::BusOff => "bus-off",
        }
    }
}

/// A frame that waits in the transmit mailbox.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mail {
    pub(crate) frame: Frame,
    pub(crate) shape: Shape,
    /// Failures that end it; `None` = tried until it is sent.
    pub(crate) attempts: Option<u8>,
    /// Earliest start in ns.
    pub(crate) ready_at: u64,
}

/// One controller on the bus.
#[derive(Debug, Default)]
pub(crate) struct Controller {
    /// Powered and initialised.
    pub(crate) running: bool,
    /// The wires are plugged in.
    pub(crate) connected: bool,
    /// Transmit error counter.
    pub(crate) tec: u16,
    /// Receive error counter.
    pub(crate) rec: u16,
    pub(crate) state: ErrorState,
    /// The mailbox.
    pub(crate) mail: Option<Mail>,
    /// Frames behind the mailbox (CAN tools only).
    pub(crate) queue: VecDeque<Frame>,
    /// An error-passive transmitter may not start before this time (suspend transmission).
    pub(crate) suspended_until: u64,
    /// Sequences of 11 recessive bits still to be seen while bus-off.
    pub(crate) recovery_left: u32,
    /// End of the attempt that is under way on the loose end of wire of an unplugged controller.
    pub(crate) alone_until: u64,
    pub(crate) bus_off_count: u32,
    pub(crate) sent: u64,
    pub(crate) received: u64,
    /// Frames that were good on the bus and that this receiver missed.
    pub(crate) lost: u64,
    /// Error frames since it was initialised.
    pub(crate) errors: u32,
}

/// What a change of the counters did to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transition {
    /// Nothing that matters to its owner.
    None,
    /// Became error passive or bus-off.
    Worse,
}

impl Controller {
    /// A controller that has just been initialised and is plugged in.
    pub(crate) fn new() -> Self {
        Self {
            running: true,
            connected: true,
            alone_until: NEVER,
            ..Self::default()
        }
    }

    /// True while the controller sees the common bus: it acknowledges and receives.
    pub(crate) fn listens(&self) -> bool {
        self.running && self.connected && self.state != ErrorState::BusOff
    }

    /// Earliest start of a transmission on the common bus, [`NEVER`] if there is nothing to send.
    pub(crate) fn ready_at(&self) -> u64 {
        match &self.mail {
            Some(mail) if self.listens() => mail.ready_at.max(self.suspended_until),
            _ => NEVER,
        }
    }

    /// As after power-on: counters at zero, nothing to send.
    pub(crate) fn reset(&mut self) {
        self.tec = 0;
        self.rec = 0;
        self.state = ErrorState::Active;
        self.mail = None;
        self.queue.clear();
        self.suspended_until = 0;
        self.alone_until = NEVER;
        self.errors = 0;
    }

    /// A frame was sent and acknowledged.
    pub(crate) fn count_sent(&mut self) {
        self.sent += 1;
        self.tec = self.tec.saturating_sub(1);
        self.judge();
    }

    /// A frame was received without error.
    pub(crate) fn count_received(&mut self) {
        self.received += 1;
        if self.rec == 0 {
            return;
        }
        self.rec = if self.rec >= PASSIVE_FROM {
            REC_AFTER_PASSIVE
        } else {
            self.rec - 1
        };
        self.judge();
    }

    /// An attempt to send was destroyed by an error frame.
    pub(crate) fn count_transmit_error(&mut self) -> Transition {
        self.errors = self.errors.wrapping_add(1);
        self.tec += 8;
        self.judge()
    }

    /// An attempt to send was acknowledged by nobody. An error-passive transmitter does not count it
    /// (exception A of the standard), so that a lonely controller never goes bus-off.
    pub(crate) fn count_acknowledge_error(&mut self) -> Transition {
        self.errors = self.errors.wrapping_add(1);
        if self.state == ErrorState::Active {
            self.tec += 8;
        }
        self.judge()
    }

    /// An error frame was seen as a receiver.
    pub(crate) fn count_receive_error(&mut self) -> Transition {
        self.errors = self.errors.wrapping_add(1);
        // Real counters have 8 bits and stop somewhere above 128; the exact stop is not observable.
        self.rec = (self.rec + 1).min(PASSIVE_FROM + 7);
        self.judge()
    }

    /// One more attempt is over; true if no further one is allowed.
    pub(crate) fn use_attempt(&mut self) -> bool {
        match self.mail.as_mut().and_then(|mail| mail.attempts.as_mut()) {
            Some(left) => {
                *left = left.saturating_sub(1);
                *left == 0
            }
            None => false,
        }
    }

    /// Counts recessive sequences while bus-off; true if the controller has come back.
    pub(crate) fn recover(&mut self, sequences: u64) -> bool {
        if self.state != ErrorState::BusOff {
            return false;
        }
        let seen = u32::try_from(sequences).unwrap_or(u32::MAX);
        self.recovery_left = self.recovery_left.saturating_sub(seen);
        if self.recovery_left > 0 {
            return false;
        }
        self.tec = 0;
        self.rec = 0;
        self.state = ErrorState::Active;
        true
    }

    /// Derives the state from the counters.
    fn judge(&mut self) -> Transition {
        let state = if self.tec >= BUS_OFF_FROM {
            ErrorState::BusOff
        } else if self.tec >= PASSIVE_FROM || self.rec >= PASSIVE_FROM {
            ErrorState::Passive
        } else {
            ErrorState::Active
        };
        let worse = state > self.state;
        self.state = state;
        if worse && state == ErrorState::BusOff {
            self.bus_off_count += 1;
            self.recovery_left = RECOVERY_SEQUENCES;
        }
        if worse {
            Transition::Worse
        } else {
            Transition::None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_follow_the_standard() {
        let mut controller = Controller::new();
        for _ in 0..15 {
            assert_eq!(controller.count_transmit_error(), Transition::None);
        }
        assert_eq!(controller.count_transmit_error(), Transition::Worse);
        assert_eq!(
            (controller.tec, controller.state),
            (128, ErrorState::Passive)
        );
        controller.count_sent();
        assert_eq!(
            (controller.tec, controller.state),
            (127, ErrorState::Active)
        );
        for _ in 0..16 {
            controller.count_transmit_error();
        }
        assert_eq!(
            (controller.tec, controller.state),
            (255, ErrorState::Passive)
        );
        assert_eq!(controller.count_transmit_error(), Transition::Worse);
        assert_eq!(controller.state, ErrorState::BusOff);
        assert_eq!(controller.bus_off_count, 1);
        assert!(!controller.recover(127));
        assert!(controller.recover(1));
        assert_eq!((controller.tec, controller.state), (0, ErrorState::Active));
    }

    #[test]
    fn a_lonely_transmitter_stops_counting_when_passive() {
        let mut controller = Controller::new();
        let worse = (0..1000)
            .filter(|_| controller.count_acknowledge_error() == Transition::Worse)
            .count();
        assert_eq!((worse, controller.tec), (1, 128));
    }

    #[test]
    fn receive_errors_make_passive_and_one_good_frame_heals() {
        let mut controller = Controller::new();
        let worse = (0..1000)
            .filter(|_| controller.count_receive_error() == Transition::Worse)
            .count();
        assert_eq!((worse, controller.state), (1, ErrorState::Passive));
        controller.count_received();
        assert_eq!(
            (controller.rec, controller.state),
            (119, ErrorState::Active)
        );
    }
}
