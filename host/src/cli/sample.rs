//! One look at a device while it runs, as a line and as JSON.

use std::time::Duration;

use serde_json::{Value as Json, json};
use windlass_core::dialect::dmc60c::wire::StatusGeneral;
use windlass_core::engine::snapshot::Fault;
use windlass_core::led::{Colour, Leds};

use crate::client::{ClosedLoopError, Status, fault_name, leds_text, mode_name};

/// The latest status of one device at a moment.
pub(super) struct Sample<'a> {
    pub(super) number: u8,
    pub(super) status: &'a Status,
    pub(super) now: Duration,
    /// What its LEDs show, if they were asked for.
    pub(super) leds: Option<Leds>,
}

impl Sample<'_> {
    /// The sample as one line; values that never came are left out.
    pub(super) fn line(&self) -> String {
        let mut parts = vec![format!("{:8.2} s", self.now.as_secs_f64())];
        parts.push(format!("device {}", self.number));
        if let Some(general) = self.status.general {
            let mode = mode_name(general.value.mode);
            let duty = self.status.duty_percent().unwrap_or_default();
            parts.push(format!("{mode} duty {duty:+6.1} %"));
        }
        if let (Some(position), Some(velocity)) = (self.status.position(), self.status.velocity()) {
            parts.push(format!("velocity {velocity:6} position {position:8}"));
        }
        if let Some(general) = self.status.general {
            parts.extend(error_text(ClosedLoopError::of(&general.value)));
        }
        if let (Some(current), Some(voltage)) = (self.status.current(), self.status.bus_voltage()) {
            let temperature = self.status.temperature().unwrap_or_default();
            parts.push(format!(
                "{current:+6.2} A {voltage:5.2} V {temperature:4.1} C"
            ));
        }
        parts.extend(self.remarks());
        parts.extend(
            self.leds
                .map(|leds| format!("LEDs {}", leds_text(Some(leds)))),
        );
        parts.join("  ")
    }

    /// The sample as a JSON document; values that never came are null.
    pub(super) fn document(&self) -> Json {
        let general = self.status.general.map(|live| live.value);
        let error = general.map(|general| ClosedLoopError::of(&general).number());
        json!({
            "t_s": self.now.as_secs_f64(),
            "number": self.number,
            "mode": general.map(|general| mode_name(general.mode)),
            "duty_percent": self.status.duty_percent(),
            "error": error,
            "position_counts": self.status.position(),
            "velocity_counts_per_100ms": self.status.velocity(),
            "current_a": self.status.current(),
            "bus_v": self.status.bus_voltage(),
            "temp_c": self.status.temperature(),
            "analog_v": self.status.analog_in(),
            "current_limited": general.map(|general| general.current_limited),
            "forward_limit": general.map(|general| general.limit_hit.forward()),
            "reverse_limit": general.map(|general| general.limit_hit.reverse()),
            "faults": general.map(|general| active_faults(&general)),
            "leds": self.leds.map(leds_document),
            "stale": self.status.is_stale(self.now),
        })
    }

    /// What is unusual.
    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(general) = self.status.general.map(|live| live.value) {
            let limits = [
                (general.limit_hit.forward(), "forward limit"),
                (general.limit_hit.reverse(), "reverse limit"),
                (general.soft_hit.forward(), "soft forward limit"),
                (general.soft_hit.reverse(), "soft reverse limit"),
                (general.current_limited, "current limited"),
            ];
            let named = limits.into_iter().filter(|(hit, _)| *hit);
            remarks.extend(named.map(|(_, name)| name.to_owned()));
            remarks.extend(active_faults(&general).into_iter().map(str::to_owned));
        }
        if self.status.is_stale(self.now) {
            remarks.push("stale".to_owned());
        }
        remarks
    }
}

/// LEDs as the bench's API shows them.
pub(super) fn leds_document(leds: Leds) -> Json {
    let ring = leds.ring.map(Colour::name);
    json!({"ring": ring, "brake": leds.brake.name()})
}

/// The active faults that the general status frame carries, by their names in the guide.
fn active_faults(general: &StatusGeneral) -> Vec<&'static str> {
    let active = Fault::ALL
        .into_iter()
        .filter(|fault| general.faults.contains(*fault));
    active.map(fault_name).collect()
}

fn error_text(error: ClosedLoopError) -> Option<String> {
    match error {
        ClosedLoopError::Counts(counts) => Some(format!("error {counts}")),
        ClosedLoopError::Amps(value) => Some(format!("error {value:+.2} A")),
        ClosedLoopError::Volts(value) => Some(format!("error {value:+.2} V")),
        // Zero but for the tick after a new target: the duty cycle itself is shown.
        ClosedLoopError::Throttle(_) | ClosedLoopError::None => None,
    }
}
