//! The control law of the DMC60C: P, I, D and feed-forward, once per 500 µs tick.
//!
//! output = P·e + I·Σe + D·Δe + F·target, gains in signed 16.16 throttle units. Errors are whole counts
//! (velocity, position) or 16.16 amperes (current), which only changes how far the sum is shifted.
//!
//! Rounding rule, the only one: products are exact in 64 bits, their sum is exact, and it is shifted
//! down once (towards minus infinity) and saturated once. The sum cannot overflow, because errors and
//! targets are limited to ±2²⁸ (268 million counts, 4096 A) before they are multiplied:
//! 2⁶² (I) + 2⁵⁹ (P) + 2⁶⁰ (D) + 2⁵⁹ (F) < 2⁶³. Saturating every product instead would double the cost
//! and change no result that a motor can show.

use super::scale::scaled;

/// Errors and targets are saturated to 29 bits, sign included: one instruction (SSAT) on a Cortex-M.
const OPERAND_MAX: i32 = (1 << 28) - 1;
const OPERAND_MIN: i32 = -(1 << 28);

/// An error or a target as the law works with it.
pub(super) fn operand(value: i32) -> i32 {
    value.clamp(OPERAND_MIN, OPERAND_MAX)
}

/// Gains of one control law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gains {
    /// Proportional gain, 16.16.
    pub p: i32,
    /// Integral gain, 16.16, for the sum over ticks.
    pub i: i32,
    /// Derivative gain, 16.16, for the difference of two ticks.
    pub d: i32,
    /// Feed-forward gain, 16.16.
    pub f: i32,
    /// The accumulator stays within ± this value (`paramClosedLoopIZone…`); `i32::MAX` for no limit, as
    /// the accumulator saturates there anyway.
    pub accumulator_limit: i32,
    /// Errors smaller than this give no P, I and D output and clear the accumulator; 0 = off.
    pub allowable_error: i32,
}

/// Unit of the error, which decides the shift of the sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Whole counts.
    Count,
    /// 16.16 numbers.
    Fixed,
}

/// State of one control law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pidf {
    accumulator: i32,
    previous_error: i32,
    /// All bits set once there is an error before this one: what the difference of two errors is masked
    /// with, one instruction instead of a branch.
    has_previous: i32,
}

impl Pidf {
    /// A law before its first step.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            accumulator: 0,
            previous_error: 0,
            has_previous: 0,
        }
    }

    /// Forgets everything, as on a change of mode or while the output is off.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Sum of errors.
    #[cfg(test)]
    const fn accumulator(&self) -> i32 {
        self.accumulator
    }

    /// One step of the law; the result is in throttle units, saturated to 32 bits.
    ///
    /// In the first step after a reset the derivative is 0.
    pub fn step(&mut self, gains: &Gains, target: i32, error: i32, unit: Unit) -> i32 {
        let target = operand(target);
        let error = operand(error);
        let change = error.wrapping_sub(self.previous_error) & self.has_previous;
        self.previous_error = error;
        self.has_previous = -1;
        let mut sum = product(gains.f, target);
        if error.wrapping_abs() < gains.allowable_error {
            self.accumulator = 0;
        } else {
            let limit = gains.accumulator_limit;
            // `limit` is never negative, see `Gains`; `min`/`max` are total where `clamp` could panic.
            self.accumulator = self
                .accumulator
                .saturating_add(error)
                .min(limit)
                .max(-limit);
            sum = sum
                .wrapping_add(product(gains.p, error))
                .wrapping_add(product(gains.i, self.accumulator))
                .wrapping_add(product(gains.d, change));
        }
        match unit {
            Unit::Count => scaled::<16>(sum),
            // Half of 64 bits always fits 32.
            Unit::Fixed => (sum >> 32) as i32,
        }
    }
}

/// An exact product.
pub(super) fn product(gain: i32, operand: i32) -> i64 {
    i64::from(gain).wrapping_mul(i64::from(operand))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NONE: Gains = Gains {
        p: 0,
        i: 0,
        d: 0,
        f: 0,
        accumulator_limit: i32::MAX,
        allowable_error: 0,
    };

    #[test]
    fn guide_feed_forward_example_gives_half_throttle_at_20_amperes() {
        // Guide, paramClosedLoopFGainSlot0: 0.5 × 32767 / 20 A = 0x03332CCC.
        let gains = Gains {
            f: 0x0333_2CCC,
            ..NONE
        };
        let output = Pidf::default().step(&gains, 20 << 16, 0, Unit::Fixed);
        assert_eq!(output, 16383);
    }

    #[test]
    fn default_current_limit_zone_is_61_percent_of_throttle() {
        // docs/dmc60c.md: 0x014CC888 amperes in 16.16 times the integral gain 60 = 19967.
        let gains = Gains {
            i: 0x003C_0000,
            accumulator_limit: 0x014C_C888,
            ..NONE
        };
        let mut law = Pidf::default();
        for _ in 0..100 {
            law.step(&gains, 0, 20 << 16, Unit::Fixed);
        }
        assert_eq!(law.step(&gains, 0, 20 << 16, Unit::Fixed), 19966);
        assert_eq!(law.accumulator(), 0x014C_C888);
    }

    #[test]
    fn accumulator_is_clamped_both_ways_and_unbounded_at_zero_zone() {
        let gains = Gains {
            i: 1 << 16,
            accumulator_limit: 250,
            ..NONE
        };
        let mut law = Pidf::default();
        for expected in [100, 200, 250, 250] {
            assert_eq!(law.step(&gains, 0, 100, Unit::Count), expected);
        }
        for expected in [150, 50, -50, -150, -250, -250] {
            assert_eq!(law.step(&gains, 0, -100, Unit::Count), expected);
        }
    }

    #[test]
    fn allowable_error_silences_pid_clears_the_accumulator_and_keeps_f() {
        let gains = Gains {
            p: 1 << 16,
            i: 1 << 16,
            d: 1 << 16,
            f: 2 << 16,
            allowable_error: 10,
            ..NONE
        };
        let mut law = Pidf::default();
        assert_eq!(law.step(&gains, 5, 10, Unit::Count), 10 + 10 + 10);
        assert_eq!(law.step(&gains, 5, 9, Unit::Count), 10);
        assert_eq!(law.accumulator(), 0);
        assert_eq!(law.step(&gains, 5, -9, Unit::Count), 10);
    }

    #[test]
    fn derivative_acts_from_the_second_step() {
        let gains = Gains { d: 3 << 16, ..NONE };
        let mut law = Pidf::default();
        assert_eq!(law.step(&gains, 0, 100, Unit::Count), 0);
        assert_eq!(law.step(&gains, 0, 110, Unit::Count), 30);
        assert_eq!(law.step(&gains, 0, 90, Unit::Count), -60);
    }

    #[test]
    fn worst_case_operands_saturate_with_the_right_sign() {
        let gains = Gains {
            p: i32::MAX,
            i: i32::MAX,
            d: i32::MAX,
            f: i32::MAX,
            accumulator_limit: i32::MAX,
            allowable_error: 0,
        };
        let mut law = Pidf::default();
        for _ in 0..20 {
            assert_eq!(law.step(&gains, i32::MAX, i32::MAX, Unit::Count), i32::MAX);
        }
        law.reset();
        for _ in 0..20 {
            assert_eq!(law.step(&gains, i32::MIN, i32::MIN, Unit::Count), i32::MIN);
        }
    }

    proptest! {
        #[test]
        fn any_sequence_equals_the_law_in_128_bits(
            p: i32, i: i32, d: i32, f: i32,
            limit in 0..=i32::MAX, allowable in 0..=i32::MAX,
            inputs in proptest::collection::vec((any::<i32>(), any::<i32>()), 1..20),
            fixed: bool,
        ) {
            let gains = Gains { p, i, d, f, accumulator_limit: limit, allowable_error: allowable };
            let (unit, shift) = if fixed { (Unit::Fixed, 32) } else { (Unit::Count, 16) };
            let mut law = Pidf::default();
            let (mut accumulator, mut previous) = (0_i128, None);
            for (target, error) in inputs {
                let limited = |value: i32| i128::from(value).clamp(-(1 << 28), (1 << 28) - 1);
                let (t, e) = (limited(target), limited(error));
                let mut sum = i128::from(f) * t;
                if e.abs() < i128::from(allowable) {
                    accumulator = 0;
                } else {
                    accumulator = (accumulator + e).clamp(-i128::from(limit), i128::from(limit));
                    sum += i128::from(p) * e + i128::from(i) * accumulator
                        + i128::from(d) * (e - previous.unwrap_or(e));
                }
                previous = Some(e);
                let expected = (sum >> shift).clamp(i128::from(i32::MIN), i128::from(i32::MAX));
                prop_assert_eq!(i128::from(law.step(&gains, target, error, unit)), expected);
            }
        }
    }
}
