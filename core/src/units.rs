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
        Self::saturating(-i32::from(self.0))
    }

    /// Size of the duty cycle without its direction, 0 to 32768.
    #[must_use]
    pub const fn magnitude(self) -> u16 {
        self.0.unsigned_abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_reverse_reverses_without_overflow() {
        assert_eq!(Duty::MIN.reversed(), Duty::MAX);
        assert_eq!(Duty::new(-5).reversed(), Duty::new(5));
        assert_eq!(Duty::saturating(40_000), Duty::MAX);
        assert_eq!(Duty::saturating(-40_000), Duty::MIN);
        assert_eq!(Duty::MIN.magnitude(), 32768);
    }
}
