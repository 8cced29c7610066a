//! What errors do to the controllers: counters, given-up frames, bus-off and the way back.

use super::{Bus, Outcome, RECESSIVE_SEQUENCE, Station};
use crate::controller::{ErrorState, NEVER, Transition};

impl Bus {
    /// The frame was destroyed by an error frame that everybody saw.
    pub(super) fn destroy(&mut self, transmitters: &[Station], outcome: &mut Outcome) {
        self.error_frames += 1;
        for &station in transmitters {
            let transition = self.controllers[station].count_transmit_error();
            self.after_transition(station, transition, outcome);
            self.end_attempt(station, outcome);
        }
        for index in 0..self.members.len() {
            let station = self.members[index];
            if self.controllers[station].listens() && !transmitters.contains(&station) {
                let transition = self.controllers[station].count_receive_error();
                self.after_transition(station, transition, outcome);
            }
        }
    }

    /// Nobody has acknowledged. That is no failed attempt: there was nothing wrong with the frame, and
    /// the controller goes on trying until it becomes error passive.
    pub(super) fn miss_acknowledge(&mut self, station: Station, outcome: &mut Outcome) {
        let transition = self.controllers[station].count_acknowledge_error();
        self.after_transition(station, transition, outcome);
    }

    /// A controller that got worse drops what it wanted to send; a CAN tool only at bus-off, because
    /// nobody tells its user.
    fn after_transition(
        &mut self,
        station: Station,
        transition: Transition,
        outcome: &mut Outcome,
    ) {
        if transition == Transition::None {
            return;
        }
        let controller = &mut self.controllers[station];
        if self.is_tool[station] && controller.state != ErrorState::BusOff {
            return;
        }
        controller.queue.clear();
        if controller.mail.take().is_some() {
            outcome.ended.push((station, false));
        }
        outcome.lost.push(station);
    }

    /// Counts an attempt that was destroyed.
    fn end_attempt(&mut self, station: Station, outcome: &mut Outcome) {
        if self.controllers[station].use_attempt() {
            self.controllers[station].mail = None;
            outcome.ended.push((station, false));
        }
    }

    /// Attempts of unplugged controllers, and bus-off recovery on a free bus.
    pub(super) fn handle_special(&mut self, now: u64, outcome: &mut Outcome) {
        self.count_idle(now);
        for index in 0..self.members.len() {
            let station = self.members[index];
            let controller = &mut self.controllers[station];
            if controller.alone_until <= now {
                controller.alone_until = NEVER;
                self.miss_acknowledge(station, outcome);
            }
        }
        self.plan(now);
    }

    /// Counts the recessive sequences of an idle span that ends now.
    pub(super) fn count_idle(&mut self, now: u64) {
        if self.on_wire.is_some() || now <= self.free_at {
            return;
        }
        let sequences = (now - self.free_at) / (RECESSIVE_SEQUENCE * self.bit);
        if self.count_recessive(sequences) {
            self.free_at += sequences * RECESSIVE_SEQUENCE * self.bit;
        }
    }

    /// True if somebody is bus-off and counts.
    pub(super) fn count_recessive(&mut self, sequences: u64) -> bool {
        let mut counted = false;
        for &station in &self.members {
            let controller = &mut self.controllers[station];
            if controller.running && controller.state == ErrorState::BusOff {
                controller.recover(sequences);
                counted = true;
            }
        }
        counted
    }
}
