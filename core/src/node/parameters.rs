//! Reading and writing parameters, the live ones included.

use super::Node;
use crate::dialect::{Outcome, Request};
use crate::engine::command::SetPosition;
use crate::engine::snapshot::{Fault, Snapshot};
use crate::management::vendor::ParameterError;
use crate::params::compile;
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
            (Some(id), None) => Ok(self.read(id, snapshot)),
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

    fn read(&self, id: ParameterId, snapshot: &Snapshot) -> u32 {
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
            (ParameterId::FramesDropped, _) => self.counters.dropped,
            (ParameterId::TransmissionsFailed, _) => self.counters.given_up,
            _ => self.stored.params.get(id),
        }
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
                self.command.set_position = SetPosition {
                    counts: value as i32,
                    generation: self.command.set_position.generation.wrapping_add(1),
                };
                return Ok(value);
            }
            ParameterId::ActiveFaults
            | ParameterId::ResetCause
            | ParameterId::SettingsState
            | ParameterId::ResetDetail
            | ParameterId::ResetPlace
            | ParameterId::ResetCount
            | ParameterId::FramesDropped
            | ParameterId::TransmissionsFailed => return Ok(self.read(id, snapshot)),
            ParameterId::StickyFaults => {
                let before = self.read(id, snapshot);
                if value != 0 && before != 0 {
                    self.faults.clear_sticky();
                    self.faults_changed(now);
                }
                return Ok(before);
            }
            _ => {}
        }
        if let Some(fault) = Self::counted_fault(id) {
            let before = self.read(id, snapshot);
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
                }
                Ok(value)
            }
            Err(_) => Err(ParameterError::BadValue),
        }
    }

    pub(super) fn parameter_changed(&mut self, now: Instant, id: ParameterId) {
        let policy = self.dialect.kind().policy();
        self.settings = compile::settings(&self.stored.params, &self.config.board, &policy);
        if id.row().storage == Storage::Persistent {
            self.keeping.changed(now);
        }
    }
}
