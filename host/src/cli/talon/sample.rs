//! One look at a Talon while it runs, as a line and as JSON.

use std::time::Duration;

use serde_json::{Value as Json, json};
use windlass_core::dialect::talon_srx::wire::ModeSelect;
use windlass_core::led::Leds;

use crate::cli::sample::leds_document;
use crate::client::leds_text;
use crate::client::talon::{FaultBits, SelfTest, TalonStatus, mode_word, units};

/// The latest status of one Talon at a moment.
pub(in crate::cli) struct Sample<'a> {
    pub(in crate::cli) number: u8,
    pub(in crate::cli) status: &'a TalonStatus,
    pub(in crate::cli) now: Duration,
    /// What its LEDs show, if they were asked for.
    pub(in crate::cli) leds: Option<Leds>,
}

impl Sample<'_> {
    fn report(&self) -> SelfTest {
        SelfTest::capture(self.number, self.status, self.now)
    }

    /// The sample as one line; values that never came are left out.
    pub(in crate::cli) fn line(&self) -> String {
        let mut parts = vec![format!("{:8.2} s", self.now.as_secs_f64())];
        parts.push(format!("talon {}", self.number));
        if let Some(general) = self.status.general.map(|stamped| stamped.value) {
            let state = if general.token_locked {
                "enabled"
            } else {
                "disabled"
            };
            let duty = units::share(general.throttle) * 100.0;
            let mode = mode_word(general.mode);
            parts.push(format!("{state}  {mode} duty {duty:+6.1} %"));
        }
        if let Some(feedback) = self.status.feedback.map(|stamped| stamped.value) {
            let (position, velocity) = (feedback.position, feedback.velocity);
            parts.push(format!("velocity {velocity:6} position {position:8}"));
        }
        if let Some(general) = self.status.general.map(|stamped| stamped.value)
            && matches!(general.mode, ModeSelect::Position | ModeSelect::Velocity)
        {
            parts.push(format!("error {}", general.error));
        }
        let report = self.report();
        if self.status.analog.is_some() {
            parts.push(format!(
                "{:6.2} A {:5.2} V {:4.1} C",
                report.current(),
                report.battery(),
                report.temperature()
            ));
        }
        parts.extend(report.faults().names().map(str::to_owned));
        if !report.responding {
            parts.push("stale".to_owned());
        }
        parts.extend(
            self.leds
                .map(|leds| format!("LEDs {}", leds_text(Some(leds)))),
        );
        parts.join("  ")
    }

    /// The sample as a JSON document; values that never came are null.
    pub(in crate::cli) fn document(&self) -> Json {
        let report = self.report();
        let general = self.status.general.map(|stamped| stamped.value);
        let feedback = self.status.feedback.map(|stamped| stamped.value);
        let analog = self.status.analog.map(|stamped| stamped.value);
        let names = |faults: FaultBits| faults.names().collect::<Vec<_>>();
        json!({
            "t_s": self.now.as_secs_f64(),
            "number": self.number,
            "dialect": super::DIALECT,
            "enabled": general.map(|general| general.token_locked),
            "mode": general.map(|general| mode_word(general.mode)),
            "duty_percent": general.map(|general| units::share(general.throttle) * 100.0),
            "error": general.map(|general| general.error),
            "position_counts": feedback.map(|feedback| feedback.position),
            "velocity_counts_per_100ms": feedback.map(|feedback| feedback.velocity),
            "current_a": feedback.map(|_| report.current()),
            "brake": feedback.map(|feedback| feedback.brake),
            "bus_v": analog.map(|_| report.battery()),
            "temp_c": analog.map(|_| report.temperature()),
            "analog_counts": analog.map(|analog| analog.position),
            "forward_limit": general.map(|general| general.faults.forward_limit),
            "reverse_limit": general.map(|general| general.faults.reverse_limit),
            "faults": general.map(|_| names(report.faults())),
            "sticky_faults": feedback.map(|_| names(report.sticky_faults())),
            "leds": self.leds.map(leds_document),
            "stale": !report.responding,
        })
    }
}
