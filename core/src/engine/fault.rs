//! Fault detection: every condition is judged here and nowhere else.
//!
//! A fault that the policy counts as a stopping one keeps the output off from the tick in which it is seen
//! until the policy's hold time has passed since it was last seen (DMC60C guide, `paramActiveFaults`: 3 s,
//! restarted by each fault). The others are active exactly while they are seen and stop nothing.

use super::sensor::Measured;
use super::settings::{Policy, Thresholds};
use super::snapshot::{Fault, Faults, Sample};

/// Both ends of the 12-bit conversion.
const ADC_RAILS: [u16; 2] = [0, 4095];

/// State of fault detection.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultMonitor {
    over_current: u16,
    current_rail: u16,
    over_temperature: u16,
    under_voltage: u16,
    hold: u16,
    /// Faults that keep the output off.
    stopping: Faults,
    /// Those, and the ones that are only shown.
    active: Faults,
    events: [u8; 4],
}

/// Counts ticks of a condition without a break; true once it has lasted `limit` ticks.
fn lasted(counter: &mut u16, condition: bool, limit: u16) -> bool {
    *counter = if condition {
        counter.saturating_add(1)
    } else {
        0
    };
    condition && *counter >= limit
}

impl FaultMonitor {
    /// No fault.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            over_current: 0,
            current_rail: 0,
            over_temperature: 0,
            under_voltage: 0,
            hold: 0,
            stopping: Faults::NONE,
            active: Faults::NONE,
            events: [0; 4],
        }
    }

    /// Judges one tick's measurements.
    pub fn update(
        &mut self,
        thresholds: &Thresholds,
        policy: &Policy,
        measured: &Measured,
        sample: &Sample,
    ) {
        let current = measured.current.saturating_abs();
        let over_current = lasted(
            &mut self.over_current,
            current >= thresholds.over_current,
            thresholds.over_current_ticks,
        );
        let rail = lasted(
            &mut self.current_rail,
            ADC_RAILS.contains(&sample.current),
            thresholds.current_rail_ticks,
        );
        let over_temperature = lasted(
            &mut self.over_temperature,
            measured.temperature >= thresholds.over_temperature,
            thresholds.over_temperature_ticks,
        );
        let under_voltage = lasted(
            &mut self.under_voltage,
            measured.bus_voltage < thresholds.under_voltage,
            thresholds.under_voltage_ticks,
        );
        let mut seen = Faults::NONE;
        for (present, fault) in [
            (over_current || rail, Fault::OverCurrent),
            (over_temperature, Fault::OverTemperature),
            (under_voltage, Fault::UnderVoltage),
            (sample.pins.gate_driver_fault, Fault::GateDriver),
        ] {
            if present {
                seen = seen.with(fault);
            }
        }
        self.hold(seen.intersection(policy.stopping), policy.fault_hold_ticks);
        let active = self.stopping.union(seen);
        if active != self.active {
            self.count(active.without(self.active));
            self.active = active;
        }
    }

    /// Stopping faults stay for the hold time after the last one was seen.
    fn hold(&mut self, seen: Faults, hold_ticks: u16) {
        if !seen.is_empty() {
            self.stopping = self.stopping.union(seen);
            // One tick at least, so that a fault is never forgotten in the tick that saw it.
            self.hold = hold_ticks.max(1);
        } else if self.hold > 0 {
            self.hold -= 1;
            if self.hold == 0 {
                self.stopping = Faults::NONE;
            }
        }
    }

    fn count(&mut self, new: Faults) {
        for (bit, count) in self.events.iter_mut().enumerate() {
            *count = count.wrapping_add((new.bits() >> bit) & 1);
        }
    }

    /// Faults that keep the output off, and those that are only shown.
    #[must_use]
    pub const fn active(&self) -> Faults {
        self.active
    }

    /// True while a fault keeps the output off.
    #[must_use]
    pub const fn stops(&self) -> bool {
        !self.stopping.is_empty()
    }

    /// Times that each fault became active, wrapping.
    #[must_use]
    pub const fn events(&self) -> [u8; 4] {
        self.events
    }
}
