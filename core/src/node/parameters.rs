//! Reading and writing parameters, the live ones included.

use super::Node;
use crate::dialect::{Outcome, Request};
use crate::engine::command::{PositionOf, SetPosition};
use crate::engine::snapshot::{Fault, Snapshot};
use crate::management::vendor::ParameterError;
use crate::params::compile;
use crate::params::journal::Crash;
use crate::params::table::{ParameterId, Storage};
use crate::time::Instant;

impl Node {
    pub(super) fn parameter(
        &mut self,
        now: Instant,
        query: Request,
        snapshot: &Snapshot,
    ) -> Outcome {
        let (parameter, write) = match query {
            Request::Read(parameter) => (parameter, None),
            Request::Write(parameter, value) => (parameter, Some(value)),
        };
        let result = match (ParameterId::from_code(parameter), write) {
            (None, _) => Err(ParameterError::BadParameter),
            (Some(id), None) => Ok(self.read(now, id, snapshot)),
            (Some(id), Some(value)) => self.write(now, id, value, snapshot),
        };
        Outcome { parameter, result }
    }

    /// The fault whose count a parameter shows.
    fn counted_fault(id: ParameterId) -> Option<Fault> {
        match id {
            ParameterId::OverCurrentCount => Some(Fault::OverCurrent),
            ParameterId::OverTemperatureCount => Some(Fault::OverTemperature),
            ParameterId::UnderVoltageCount => Some(Fault::UnderVoltage),
            ParameterId::GateDriverCount => Some(Fault::GateDriver),
            ParameterId::CommunicationCount => Some(Fault::Communication),
            _ => None,
        }
    }

    fn read(&self, now: Instant, id: ParameterId, snapshot: &Snapshot) -> u32 {
        match (id, Self::counted_fault(id)) {
            (_, Some(fault)) => u32::from(self.faults.count(fault)),
            (ParameterId::EncoderPosition, _) => snapshot.position as u32,
            (ParameterId::ActiveFaults, _) => u32::from(snapshot.faults.bits()),
            (ParameterId::StickyFaults, _) => u32::from(self.faults.sticky().bits()),
            (ParameterId::ResetCause, _) => u32::from(self.config.reset.cause as u8),
            (ParameterId::SettingsState, _) => self.settings_state() as u32,
            (ParameterId::ResetDetail, _) => self.config.reset.detail,
            (ParameterId::ResetPlace, _) => self.config.reset.place,
            (ParameterId::ResetCount, _) => self.config.reset.count,
            (ParameterId::CrashCause, _) => self.crash(|crash| crash.cause as u32),
            (ParameterId::CrashDetail, _) => self.crash(|crash| crash.detail),
            (ParameterId::CrashPlace, _) => self.crash(|crash| crash.place),
            (ParameterId::FramesDropped, _) => self.counters.dropped,
            (ParameterId::TransmissionsFailed, _) => self.counters.given_up,
            (ParameterId::Leds, _) => self.leds(now, snapshot).to_bits(),
            _ => self.stored.params.get(id),
        }
    }

    /// Something of the latest crash; 0 if none is known.
    fn crash(&self, part: impl FnOnce(&Crash) -> u32) -> u32 {
        self.config.crash.as_ref().map_or(0, part)
    }

    /// Writes a parameter and gives its value in force; for faults and counts the value before it was
    /// cleared (guide, `paramStickyFaults`).
    fn write(
        &mut self,
        now: Instant,
        id: ParameterId,
        value: u32,
        snapshot: &Snapshot,
    ) -> Result<u32, ParameterError> {
        match id {
            ParameterId::EncoderPosition => {
                self.set_position(PositionOf::Selected, value as i32);
                return Ok(value);
            }
            ParameterId::ActiveFaults
            | ParameterId::ResetCause
            | ParameterId::SettingsState
            | ParameterId::ResetDetail
            | ParameterId::ResetPlace
            | ParameterId::ResetCount
            | ParameterId::CrashCause
            | ParameterId::CrashDetail
            | ParameterId::CrashPlace
            | ParameterId::FramesDropped
            | ParameterId::TransmissionsFailed
            | ParameterId::Leds => return Ok(self.read(now, id, snapshot)),
            ParameterId::StickyFaults => {
                let before = self.read(now, id, snapshot);
                if value != 0 && before != 0 {
                    self.faults.clear_sticky();
                    self.faults_changed(now);
                }
                return Ok(before);
            }
            _ => {}
        }
        if let Some(fault) = Self::counted_fault(id) {
            let before = self.read(now, id, snapshot);
            if value != 0 && before != 0 {
                self.faults.clear_count(fault);
                self.faults_changed(now);
            }
            return Ok(before);
        }
        match self.stored.params.set(id, value) {
            Ok(changed) => {
                if changed {
                    self.parameter_changed(now, id);
                    if pauses(id) {
                        let command = self.revise();
                        command.pause = command.pause.wrapping_add(1);
                    }
                }
                Ok(value)
            }
            Err(_) => Err(ParameterError::BadValue),
        }
    }

    /// Orders the engine to overwrite a position.
    pub(super) fn set_position(&mut self, of: PositionOf, counts: i32) {
        let order = &mut self.revise().set_position;
        let generation = order.generation.wrapping_add(1);
        *order = SetPosition {
            of,
            counts,
            generation,
        };
    }

    /// Keeps the faults and limits that are present as sticky ones, where the policy says so.
    pub(super) fn observe_presence(&mut self, now: Instant, snapshot: &Snapshot) {
        let limits = &snapshot.limits;
        let present = limits.tripped().bits() | limits.soft_hit.bits() << 2;
        let before = self.stored.params.get(ParameterId::StickyLimits);
        let new_limits = self.keep_limits(before | u32::from(present));
        if self.faults.keep(snapshot.faults) || new_limits {
            self.faults_changed(now);
        }
    }

    /// Forgets the sticky faults and limits; the counts of faults stay.
    pub(super) fn clear_sticky(&mut self, now: Instant) {
        let faults = !self.faults.sticky().is_empty();
        self.faults.clear_sticky();
        if self.keep_limits(0) || faults {
            self.faults_changed(now);
        }
    }

    /// Overwrites the sticky limits; true if that changed anything.
    fn keep_limits(&mut self, bits: u32) -> bool {
        self.stored.params.set(ParameterId::StickyLimits, bits) == Ok(true)
    }

    pub(super) fn parameter_changed(&mut self, now: Instant, id: ParameterId) {
        let policy = self.dialect.kind().policy();
        self.settings = compile::settings(&self.stored.params, &self.config.board, &policy);
        if id.rule().storage == Storage::Persistent {
            self.keeping.changed(now);
        }
    }
}

/// Parameters whose change makes the drive pause, if the policy has a time for it: the types of the limit
/// switches and the stored neutral behaviour (Talon SRX manual, 4.2 and 4.4).
const fn pauses(id: ParameterId) -> bool {
    matches!(
        id,
        ParameterId::ForwardLimitNormallyClosed
            | ParameterId::ForwardLimitDisabled
            | ParameterId::ReverseLimitNormallyClosed
            | ParameterId::ReverseLimitDisabled
            | ParameterId::BrakeAtNeutral
    )
}
