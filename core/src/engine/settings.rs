//! Everything that is configured, in the units that a tick needs.
//!
//! Parameters are compiled into [`Settings`] outside the tick, whenever one changes; the tick gets the
//! whole value and so never sees half a change. Raw 16.16 numbers stand here as `i32` because the
//! control path multiplies them with integers.

use super::command::Neutral;
use super::limit::Directions;
use super::pidf::Gains;
pub use super::policy::{
    Enabling, Indicated, Law, Policy, Resume, SensorSet, SoftThreshold, Sticky,
};
use super::throttle_law::ThrottleGains;
use crate::time::TICKS_PER_MS;

/// A linear conversion of a 12-bit sample: `offset + gain × sample`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear {
    /// Result at sample 0, 16.16.
    pub offset: i32,
    /// Result of one step, in units of 2⁻²⁰; at most 2¹⁹ so that the product of a sample fits 32 bits.
    pub gain: i32,
}

impl Linear {
    /// The converted sample, 16.16; nonsense, but no panic, for a sample above 4095.
    #[must_use]
    pub fn convert(self, sample: u16) -> i32 {
        let product = self.gain.wrapping_mul(i32::from(sample));
        self.offset.wrapping_add(product >> 4)
    }
}

/// Linear derating of the duty cycle between two temperatures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Derating {
    /// Full duty cycle up to here, 16.16 °C.
    from: i32,
    /// None from here on, 16.16 °C.
    to: i32,
    /// Throttle units for each step of temperature below `to`, in units of 2⁻³²: a multiplication in the
    /// tick instead of a division.
    slope: i32,
}

impl Derating {
    /// Full duty cycle as a cap.
    pub const FULL: i32 = 32768;

    /// No derating at any temperature that can be measured.
    pub const NONE: Self = Self::new(i16::MAX - 1, i16::MAX);

    /// Derating between two temperatures in whole degrees Celsius; `to` is at least one degree above
    /// `from`, else it is taken as that.
    #[must_use]
    pub const fn new(from: i16, to: i16) -> Self {
        let to = if to > from {
            to
        } else {
            from.saturating_add(1)
        };
        let (from, to) = ((from as i32) << 16, (to as i32) << 16);
        let span = to as i64 - from as i64;
        // A span of one degree or more keeps the slope within 31 bits.
        let slope = (((Self::FULL as i64) << 32) / (span + 1)) as i32;
        Self { from, to, slope }
    }

    /// True if a case temperature (16.16 °C) lowers the cap.
    #[must_use]
    pub const fn acts(&self, temperature: i32) -> bool {
        temperature > self.from
    }

    /// Cap on the size of the duty cycle at a case temperature (16.16 °C).
    #[must_use]
    pub fn cap(&self, temperature: i32) -> i32 {
        if !self.acts(temperature) {
            return Self::FULL;
        }
        let left = self.to.saturating_sub(temperature).max(0);
        ((i64::from(left) * i64::from(self.slope)) >> 32) as i32
    }
}

/// When a fault is recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thresholds {
    /// Over-current: size of the current, 16.16 A …
    pub over_current: i32,
    /// … for this many ticks.
    pub over_current_ticks: u16,
    /// Over-current as well: the current conversion at either end of its range for this many ticks.
    pub current_rail_ticks: u16,
    /// Over-temperature, 16.16 °C …
    pub over_temperature: i32,
    /// … for this many ticks.
    pub over_temperature_ticks: u16,
    /// Derating of the duty cycle towards `over_temperature`.
    pub derating: Derating,
    /// Under-voltage: bus voltage below this, 16.16 V …
    pub under_voltage: i32,
    /// … for this many ticks.
    pub under_voltage_ticks: u16,
}

/// What a board is: conversion factors of its analog inputs and its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Bus voltage in volts.
    pub bus_voltage: Linear,
    /// Case temperature in degrees Celsius.
    pub temperature: Linear,
    /// AIN1 in volts.
    pub analog_in: Linear,
    /// Fault thresholds.
    pub thresholds: Thresholds,
}

impl Board {
    /// The reference board: the bench's plant, and the DMC60C's limits.
    ///
    /// Analog inputs have 12 bits over 3.3 V: bus voltage behind a divider of 11 : 1 (36.3 V full scale),
    /// a temperature sensor of 0.5 V at 0 °C and 10 mV/°C, AIN1 direct. Under-voltage is the guide's
    /// (`paramUnderVoltageStkyFltCnt`); the other thresholds are decisions of `docs/dmc60c.md`: the
    /// sense range ends at ±64.7 A, so over-current is 62 A for 4 s, or the conversion at a rail for 1 s.
    pub const REFERENCE: Self = Self {
        bus_voltage: Linear {
            offset: 0,
            gain: 9293,
        },
        temperature: Linear {
            offset: -50 << 16,
            gain: 84_480,
        },
        analog_in: Linear {
            offset: 0,
            gain: 845,
        },
        thresholds: Thresholds {
            over_current: 62 << 16,
            over_current_ticks: (4000 * TICKS_PER_MS) as u16,
            current_rail_ticks: (1000 * TICKS_PER_MS) as u16,
            over_temperature: 105 << 16,
            over_temperature_ticks: 4,
            derating: Derating::new(85, 105),
            under_voltage: (575 << 16) / 100,
            under_voltage_ticks: (5000 * TICKS_PER_MS) as u16,
        },
    };
}

/// One gain slot: control law and shaping of its output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlotSettings {
    /// Control law.
    pub gains: Gains,
    /// Largest change of the duty cycle per tick, throttle units; 0 = at once.
    pub ramp: i32,
    /// Largest forward duty cycle, 0 to 32767.
    pub forward_max: i32,
    /// Largest reverse duty cycle, −32768 to 0.
    pub reverse_max: i32,
    /// Smallest forward duty cycle that is applied while the error exceeds the allowable error.
    pub forward_nominal: i32,
    /// The same for reverse, −32768 to 0.
    pub reverse_nominal: i32,
}

/// Current limiter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CurrentLimit {
    /// The limiter works.
    pub enabled: bool,
    /// Limiting begins above this current, 16.16 A …
    pub begin_above: i32,
    /// … seen for more than this many ticks without a break.
    pub begin_after_ticks: u32,
    /// Current to hold, 16.16 A.
    pub continuous: i32,
    /// Control law, its output being a cap on the size of the duty cycle.
    pub gains: Gains,
}

/// The limit switches with the soft limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LimitSettings {
    /// Switches that open when they are hit.
    pub normally_closed: Directions,
    /// Switches that do not limit.
    pub switch_disabled: Directions,
    /// Soft limits that work.
    pub soft_enabled: Directions,
    /// Switches that clear the position while they are hit.
    pub clears_position: Directions,
    /// Position from which on the forward soft limit acts, counts.
    pub forward_threshold: i32,
    /// Position down from which the reverse soft limit acts, counts.
    pub reverse_threshold: i32,
}

/// What the index pin does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexSettings {
    /// An edge clears the position.
    pub clears_position: bool,
    /// The edge is a rising one.
    pub rising: bool,
}

/// Everything configured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Stopping and resuming.
    pub policy: Policy,
    /// The two gain slots of [`Law::PerTick`].
    pub slots: [SlotSettings; 2],
    /// The two gain slots of [`Law::Throttle`].
    pub throttle_slots: [ThrottleGains; 2],
    /// Current limiter.
    pub current_limit: CurrentLimit,
    /// Hard and soft limits.
    pub limits: LimitSettings,
    /// Index pin.
    pub index: IndexSettings,
    /// Neutral behaviour while no command overrides it.
    pub neutral: Neutral,
    /// Current of one conversion step, 16.16 A.
    pub current_multiplier: i32,
    /// Board.
    pub board: Board,
}

impl Settings {
    /// Gains of the given slot under [`Law::Throttle`].
    #[must_use]
    pub const fn throttle_slot(&self, slot: super::command::Slot) -> &ThrottleGains {
        let [zero, one] = &self.throttle_slots;
        match slot {
            super::command::Slot::Zero => zero,
            super::command::Slot::One => one,
        }
    }

    /// Settings of the given slot.
    #[must_use]
    pub const fn slot(&self, slot: super::command::Slot) -> &SlotSettings {
        let [zero, one] = &self.slots;
        match slot {
            super::command::Slot::Zero => zero,
            super::command::Slot::One => one,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn derating_is_linear_from_85_to_105_degrees() {
        let at = |celsius: i32| Board::REFERENCE.thresholds.derating.cap(celsius << 16);
        assert_eq!(
            [at(84), at(85), at(90), at(95), at(105), at(150)],
            [32768, 32768, 24575, 16383, 0, 0]
        );
    }

    proptest! {
        #[test]
        fn derating_stays_within_its_ends(from: i16, to: i16, temperature: i32) {
            let cap = Derating::new(from, to).cap(temperature);
            prop_assert!((0..=Derating::FULL).contains(&cap), "{}", cap);
        }
    }
}
