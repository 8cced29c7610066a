//! Fault detection: every condition is judged here and nowhere else.
//!
//! A fault that the policy counts as a stopping one keeps the output off from the tick in which it is seen
//! until the policy's hold time has passed since it was last seen (DMC60C guide, `paramActiveFaults`: 3 s,
//! restarted by each fault). The others are active exactly while they are seen and stop nothing.

use super::settings::Settings;
use super::snapshot::{Fault, Faults, Pin, Sample, Snapshot};

/// Upper end of the 12-bit conversion; the lower one is 0.
const ADC_FULL: u16 = 4095;

/// True for a conversion at either end.
const fn is_rail(conversion: u16) -> bool {
    conversion == 0 || conversion == ADC_FULL
}

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
    /// A condition was seen in the tick before: a counter is not 0, or a fault is shown that ends with it.
    unsettled: bool,
}

/// Counts ticks of a condition without a break; true once it has lasted `limit` ticks.
fn lasted(counter: &mut u16, condition: bool, limit: u16) -> bool {
    if !condition {
        *counter = 0;
        return false;
    }
    *counter = counter.saturating_add(1);
    *counter >= limit
}

/// Counts the faults that have become active.
#[cold]
fn count(events: &mut [u8; 4], new: Faults) {
    for (bit, count) in events.iter_mut().enumerate() {
        *count = count.wrapping_add((new.bits() >> bit) & 1);
    }
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
            unsettled: false,
        }
    }

    /// Judges one tick's measurements and shows what they mean.
    #[inline]
    pub fn update(&mut self, settings: &Settings, sample: &Sample, shown: &mut Snapshot) {
        let thresholds = &settings.board.thresholds;
        // Nothing is seen and nothing was: what nearly every tick finds.
        if !self.unsettled
            && shown.current.to_bits().unsigned_abs() < thresholds.over_current as u32
            && !is_rail(sample.current)
            && shown.temperature.to_bits() < thresholds.over_temperature
            && shown.bus_voltage.to_bits() >= thresholds.under_voltage
            && !sample.pins.is_high(Pin::GateDriverFault)
        {
            if self.hold > 0 {
                self.wait(shown);
            }
            return;
        }
        self.judge(settings, sample, shown);
    }

    /// One tick of the hold time.
    fn wait(&mut self, shown: &mut Snapshot) {
        self.hold -= 1;
        if self.hold == 0 {
            self.stopping = Faults::NONE;
            shown.faults = Faults::NONE;
        }
    }

    #[inline(never)]
    fn judge(&mut self, settings: &Settings, sample: &Sample, shown: &mut Snapshot) {
        let (thresholds, policy) = (&settings.board.thresholds, &settings.policy);
        let over_current = lasted(
            &mut self.over_current,
            shown.current.to_bits().unsigned_abs() >= thresholds.over_current as u32,
            thresholds.over_current_ticks,
        );
        let rail = lasted(
            &mut self.current_rail,
            is_rail(sample.current),
            thresholds.current_rail_ticks,
        );
        let over_temperature = lasted(
            &mut self.over_temperature,
            shown.temperature.to_bits() >= thresholds.over_temperature,
            thresholds.over_temperature_ticks,
        );
        let under_voltage = lasted(
            &mut self.under_voltage,
            shown.bus_voltage.to_bits() < thresholds.under_voltage,
            thresholds.under_voltage_ticks,
        );
        let gate_driver = sample.pins.is_high(Pin::GateDriverFault);
        let seen = Faults::NONE
            .with_if(Fault::OverCurrent, over_current | rail)
            .with_if(Fault::OverTemperature, over_temperature)
            .with_if(Fault::UnderVoltage, under_voltage)
            .with_if(Fault::GateDriver, gate_driver);
        let stopping = seen.intersection(policy.stopping);
        if !stopping.is_empty() {
            self.stopping = self.stopping.union(stopping);
            // One tick at least, so that a fault is never forgotten in the tick that saw it.
            self.hold = policy.fault_hold_ticks.max(1);
        } else if self.hold > 0 {
            self.wait(shown);
        }
        let active = self.stopping.union(seen);
        let new = active.without(shown.faults);
        shown.faults = active;
        if !new.is_empty() {
            count(&mut shown.fault_events, new);
        }
        let waiting =
            self.over_current | self.current_rail | self.over_temperature | self.under_voltage;
        self.unsettled = !seen.is_empty() || waiting != 0;
    }

    /// True while a fault keeps the output off.
    #[must_use]
    pub const fn stops(&self) -> bool {
        !self.stopping.is_empty()
    }
}
