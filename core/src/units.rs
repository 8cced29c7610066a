//! Physical quantities in fixed point.
//!
//! The control path knows no floating point: the same inputs give the same outputs, bit for bit, on
//! every machine and in every build profile. Electrical quantities are signed 16.16
//! ([`fixed::types::I16F16`]), which covers ±32768 units in steps of 15 µ-units and is the format of
//! the DMC60C's own parameters.

use fixed::types::I16F16;

/// Electric current in amperes, positive from the M+ terminal to M−.
pub type Amps = I16F16;
/// Electric potential in volts.
pub type Volts = I16F16;
/// Temperature in degrees Celsius.
pub type Celsius = I16F16;

/// Duty cycle of the bridge ("throttle units" of the DMC60C guide): −32768 (full reverse) to 32767
/// (full forward). Positive means that M+ is above M−.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duty(i16);

/// Full forward in 10-bit throttle units (Talon SRX manual, 17.5).
pub const THROTTLE_FULL: i32 = 1023;

impl Duty {
    /// No output.
    pub const ZERO: Self = Self(0);
    /// Full forward.
    pub const MAX: Self = Self(i16::MAX);
    /// Full reverse.
    pub const MIN: Self = Self(i16::MIN);

    /// A duty cycle from throttle units.
    #[must_use]
    pub const fn new(units: i16) -> Self {
        Self(units)
    }

    /// A duty cycle from a wider number, saturated at full forward or full reverse.
    #[must_use]
    pub fn saturating(units: i32) -> Self {
        Self(units.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16)
    }

    /// The duty cycle in throttle units.
    #[must_use]
    pub const fn units(self) -> i16 {
        self.0
    }

    /// The duty cycle in the other direction. Full reverse turns into full forward (32767).
    #[must_use]
    pub fn reversed(self) -> Self {
        Self(self.0.saturating_neg())
    }

    /// A duty cycle from 10-bit throttle units (−[`THROTTLE_FULL`] to [`THROTTLE_FULL`], saturated).
    ///
    /// throttle × 32768 / 1023 rounded to the nearest, so that ±1023 are full forward (32767) and full
    /// reverse (−32768), and [`Duty::throttle`] gives every throttle back.
    #[must_use]
    pub fn from_throttle(throttle: i32) -> Self {
        // 2¹⁵ × 32768 / 1023: exact enough for the nearest, as every throttle is at least 1/2046 away from a half.
        const FACTOR: i32 = 1_049_601;
        // A power of two, unlike the last throttle, which is saturated below: one instruction (SSAT) on a Cortex-M.
        let throttle = throttle.clamp(-THROTTLE_FULL - 1, THROTTLE_FULL);
        Self::saturating((throttle * FACTOR + (1 << 14)) >> 15)
    }

    /// The duty cycle in 10-bit throttle units, rounded to the nearest: −1023 to 1023.
    #[must_use]
    pub fn throttle(self) -> i32 {
        divided(i32::from(self.0) * THROTTLE_FULL, 32768)
    }

    /// Size of the duty cycle without its direction, 0 to 32768.
    #[must_use]
    pub const fn magnitude(self) -> u16 {
        self.0.unsigned_abs()
    }
}

/// `numerator` / `denominator` (which is positive), halves away from zero: both directions alike.
const fn divided(numerator: i32, denominator: i32) -> i32 {
    let half = if numerator < 0 {
        -(denominator / 2)
    } else {
        denominator / 2
    };
    (numerator + half) / denominator
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_throttle_survives_the_duty_and_the_ends_are_full() {
        for throttle in -1023..=1023 {
            let duty = Duty::from_throttle(throttle);
            assert_eq!(duty, Duty::saturating(divided(throttle * 32768, 1023)));
            assert_eq!(duty.throttle(), throttle);
            if throttle > -1023 && throttle < 1023 {
                assert_eq!(duty.reversed(), Duty::from_throttle(-throttle));
            }
        }
        assert_eq!(Duty::from_throttle(1023), Duty::MAX);
        assert_eq!(Duty::from_throttle(-1023), Duty::MIN);
        assert_eq!(Duty::from_throttle(i32::MAX), Duty::MAX);
        assert_eq!(Duty::from_throttle(-1024), Duty::MIN);
        assert_eq!(Duty::from_throttle(i32::MIN), Duty::MIN);
        assert_eq!(Duty::from_throttle(512), Duty::new(16400));
    }

    #[test]
    fn full_reverse_reverses_without_overflow() {
        assert_eq!(Duty::MIN.reversed(), Duty::MAX);
        assert_eq!(Duty::new(-5).reversed(), Duty::new(5));
        assert_eq!(Duty::saturating(40_000), Duty::MAX);
        assert_eq!(Duty::saturating(-40_000), Duty::MIN);
        assert_eq!(Duty::MIN.magnitude(), 32768);
    }
}
