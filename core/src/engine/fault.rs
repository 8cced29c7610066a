//! Fault detection: every condition is judged here and nowhere else.
//!
//! A fault that the policy counts as a stopping one keeps the output off from the tick in which it is seen
//! until the policy's hold time has passed since it was last seen (DMC60C guide, `paramActiveFaults`: 3 s,
//! restarted by each fault). The others are active exactly while they are seen and stop nothing.

use super::settings::{Policy, Settings, Thresholds};
use super::snapshot::{Fault, Faults, Pin, Sample, Snapshot};

/// Upper end of the 12-bit conversion; the lower one is 0.
const ADC_FULL: u16 = 4095;

/// True for a conversion at either end.
const fn is_rail(conversion: u16) -> bool {
    conversion == 0 || conversion == ADC_FULL
}

/// What can be wrong in a tick, in the order of these bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Conditions(u8);

impl Conditions {
    const NONE: Self = Self(0);
    const OVER_CURRENT: u8 = 1 << 0;
    const CURRENT_RAIL: u8 = 1 << 1;
    const OVER_TEMPERATURE: u8 = 1 << 2;
    const UNDER_VOLTAGE: u8 = 1 << 3;
    const GATE_DRIVER: u8 = 1 << 4;

    /// Those of one tick.
    #[inline]
    fn of(thresholds: &Thresholds, sample: &Sample, shown: &Snapshot) -> Self {
        let bit = |is: bool, bit: u8| if is { bit } else { 0 };
        let current = shown.current.to_bits().unsigned_abs();
        let (temperature, bus_voltage) = (shown.temperature.to_bits(), shown.bus_voltage.to_bits());
        Self(
            bit(
                current >= thresholds.over_current as u32,
                Self::OVER_CURRENT,
            ) | bit(is_rail(sample.current), Self::CURRENT_RAIL)
                | bit(
                    temperature >= thresholds.over_temperature,
                    Self::OVER_TEMPERATURE,
                )
                | bit(bus_voltage < thresholds.under_voltage, Self::UNDER_VOLTAGE)
                | bit(sample.pins.is_high(Pin::GateDriverFault), Self::GATE_DRIVER),
        )
    }

    /// True if there is none in this tick: what nearly every tick finds, and in half the time of [`Conditions::of`].
    #[inline]
    fn are_absent(thresholds: &Thresholds, sample: &Sample, shown: &Snapshot) -> bool {
        shown.current.to_bits().unsigned_abs() < thresholds.over_current as u32
            && !is_rail(sample.current)
            && shown.temperature.to_bits() < thresholds.over_temperature
            && shown.bus_voltage.to_bits() >= thresholds.under_voltage
            && !sample.pins.is_high(Pin::GateDriverFault)
    }

    const fn has(self, condition: u8) -> bool {
        self.0 & condition != 0
    }
}

/// State of fault detection.
///
/// While the conditions stay what they are, nothing changes but times. So only a change of them, and the end of
/// the first of these times, is looked at closely; between the two a tick counts itself and nothing else.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultMonitor {
    /// Conditions of the tick before.
    conditions: Conditions,
    /// Ticks that each had lasted when it was looked at.
    over_current: u16,
    current_rail: u16,
    over_temperature: u16,
    under_voltage: u16,
    /// Ticks that the hold time had left then; it passes unless `holding`.
    hold: u16,
    /// A fault that stops is seen.
    holding: bool,
    /// Ticks from then on in which there is nothing to look at, and how many of them are left.
    quiet: u16,
    quiet_left: u16,
    /// Faults that keep the output off.
    stopping: Faults,
    /// Nothing was seen in the tick before, and no time runs.
    calm: bool,
}

/// Times while the conditions are looked at.
struct Look {
    /// Conditions before and now.
    before: Conditions,
    now: Conditions,
    /// Quiet ticks that have passed.
    passed: u16,
    /// Quiet ticks that follow.
    quiet: u16,
}

impl Look {
    /// Counts this tick and those that have passed; true once the condition has lasted `limit` ticks.
    #[inline]
    fn lasts(&mut self, ticks: &mut u16, condition: u8, limit: u16) -> bool {
        if !self.now.has(condition) {
            return false;
        }
        let before = if self.before.has(condition) {
            ticks.saturating_add(self.passed)
        } else {
            0
        };
        *ticks = before.saturating_add(1);
        let left = limit.saturating_sub(*ticks);
        self.wait(left);
        left == 0
    }

    /// Something ends in `left` ticks, if that is not 0.
    #[inline]
    fn wait(&mut self, left: u16) {
        // No end wraps to the longest time.
        self.quiet = self.quiet.min(left.wrapping_sub(1));
    }
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
            conditions: Conditions::NONE,
            over_current: 0,
            current_rail: 0,
            over_temperature: 0,
            under_voltage: 0,
            hold: 0,
            holding: false,
            quiet: 0,
            quiet_left: 0,
            stopping: Faults::NONE,
            calm: true,
        }
    }

    /// Judges one tick's measurements and shows what they mean. How long a condition has to last, and what stops,
    /// is taken from the settings when the conditions change.
    #[inline]
    pub fn update(&mut self, settings: &Settings, sample: &Sample, shown: &mut Snapshot) {
        let thresholds = &settings.board.thresholds;
        if self.calm && Conditions::are_absent(thresholds, sample, shown) {
            return;
        }
        let conditions = Conditions::of(thresholds, sample, shown);
        if conditions == self.conditions && self.quiet_left > 0 {
            self.quiet_left -= 1;
        } else {
            self.judge(settings, conditions, shown);
        }
    }

    /// Looks at the conditions and their times.
    #[inline(never)]
    fn judge(&mut self, settings: &Settings, conditions: Conditions, shown: &mut Snapshot) {
        let mut look = Look {
            before: self.conditions,
            now: conditions,
            passed: self.quiet - self.quiet_left,
            quiet: u16::MAX,
        };
        self.conditions = conditions;
        let seen = self.seen(&mut look, &settings.board.thresholds);
        self.stop(&mut look, seen, &settings.policy, shown);
        (self.quiet, self.quiet_left) = (look.quiet, look.quiet);
        self.calm = conditions == Conditions::NONE && self.hold == 0;

        let active = self.stopping.union(seen);
        let new = active.without(shown.faults);
        shown.faults = active;
        if !new.is_empty() {
            count(&mut shown.fault_events, new);
        }
    }

    /// Faults whose conditions have lasted long enough.
    #[inline]
    fn seen(&mut self, look: &mut Look, limits: &Thresholds) -> Faults {
        let over_current = look.lasts(
            &mut self.over_current,
            Conditions::OVER_CURRENT,
            limits.over_current_ticks,
        );
        let rail = look.lasts(
            &mut self.current_rail,
            Conditions::CURRENT_RAIL,
            limits.current_rail_ticks,
        );
        let over_temperature = look.lasts(
            &mut self.over_temperature,
            Conditions::OVER_TEMPERATURE,
            limits.over_temperature_ticks,
        );
        let under_voltage = look.lasts(
            &mut self.under_voltage,
            Conditions::UNDER_VOLTAGE,
            limits.under_voltage_ticks,
        );
        Faults::NONE
            .with_if(Fault::OverCurrent, over_current | rail)
            .with_if(Fault::OverTemperature, over_temperature)
            .with_if(Fault::UnderVoltage, under_voltage)
            .with_if(Fault::GateDriver, look.now.has(Conditions::GATE_DRIVER))
    }

    /// Keeps the output off while a fault that stops is seen, and for the hold time after it.
    #[inline]
    fn stop(&mut self, look: &mut Look, seen: Faults, policy: &Policy, shown: &mut Snapshot) {
        let stopping = seen.intersection(policy.stopping);
        let passed = if self.holding { 0 } else { look.passed };
        self.holding = !stopping.is_empty();
        if self.holding {
            self.stopping = self.stopping.union(stopping);
            // One tick at least, so that a fault is never forgotten in the tick that saw it.
            self.hold = policy.fault_hold_ticks.max(1);
        } else if self.hold > 0 {
            self.hold = self.hold.saturating_sub(passed).saturating_sub(1);
            look.wait(self.hold);
            if self.hold == 0 {
                self.stopping = Faults::NONE;
                shown.faults = Faults::NONE;
            }
        }
    }

    /// True while a fault keeps the output off.
    #[must_use]
    pub const fn stops(&self) -> bool {
        !self.stopping.is_empty()
    }
}
