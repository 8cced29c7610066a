//! P, I, D and feed-forward in throttle units, once per millisecond.
//!
//! Source: Talon SRX manual, 18 ("How is the closed-loop implemented?"), restated in `docs/talon-srx.md`.
//! Gains are 10.22 numbers: P, I and D unsigned, F signed. Rounding rule: every term for itself, product
//! in 64 bits, truncated toward zero and saturated to 32 bits; sums saturate. `out` is kept unclamped, so
//! that a ramp may wind past full throttle; what is applied is clamped.

use super::scale::scaled;

/// Fractional bits of a gain.
const GAIN_SHIFT: u32 = 22;

/// Gains of one slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThrottleGains {
    /// Throttle per unit of error, unsigned 10.22.
    pub p: u32,
    /// Throttle per unit of accumulated error, unsigned 10.22.
    pub i: u32,
    /// Throttle per unit of change of the error in 1 ms, unsigned 10.22.
    pub d: u32,
    /// Throttle per unit of the target, signed 10.22.
    pub f: i32,
    /// The accumulator is cleared while the size of the error is not below this, see [`zone`].
    pub zone: u32,
    /// Largest change of the output per step in throttle units, not negative; 0 = at once.
    pub ramp: i32,
}

/// The zone of a parameter's value: 0 = the accumulator is never cleared; no error is below a negative one.
#[must_use]
pub const fn zone(parameter: i32) -> u32 {
    match parameter {
        0 => u32::MAX,
        ..0 => 0,
        zone => zone as u32,
    }
}

/// What goes into one step besides the gains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Input {
    /// Target in sensor units.
    pub target: i32,
    /// Measured position or velocity, after sensor reversal.
    pub measured: i32,
    /// Throttle applied now, from which the first step starts.
    pub applied: i32,
    /// The output is turned.
    pub reverse: bool,
    /// The sensor knows one direction only: the output is never negative before it is turned.
    pub one_direction: bool,
}

/// State of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThrottleLaw {
    running: bool,
    previous_error: i32,
    accumulator: i32,
    out: i32,
}

impl ThrottleLaw {
    /// A law before its first step.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            running: false,
            previous_error: 0,
            accumulator: 0,
            out: 0,
        }
    }

    /// Sum of errors.
    #[must_use]
    pub const fn accumulator(&self) -> i32 {
        self.accumulator
    }

    /// Overwrites the sum of errors.
    pub fn set_accumulator(&mut self, value: i32) {
        self.accumulator = value;
    }

    /// Error of the latest step.
    #[must_use]
    pub const fn error(&self) -> i32 {
        self.previous_error
    }

    /// Output of the latest step, not clamped.
    #[must_use]
    pub const fn out(&self) -> i32 {
        self.out
    }

    /// One step; gives the output, not clamped.
    // Inlined: its input would go through memory, and only one place of an image calls it.
    #[inline(always)]
    pub fn step(&mut self, gains: &ThrottleGains, input: &Input) -> i32 {
        let error = input.target.saturating_sub(input.measured);
        let change = if self.running {
            self.accumulator = if error.unsigned_abs() < gains.zone {
                self.accumulator.saturating_add(error)
            } else {
                0
            };
            error.saturating_sub(self.previous_error)
        } else {
            self.accumulator = 0;
            self.out = input.applied;
            0
        };
        self.previous_error = error;
        self.running = true;
        let mut output = unsigned_term(error, gains.p)
            .saturating_add(unsigned_term(self.accumulator, gains.i))
            .saturating_add(unsigned_term(change, gains.d))
            .saturating_add(signed_term(input.target, gains.f));
        if input.one_direction {
            output = output.max(0);
        }
        if input.reverse {
            output = output.saturating_neg();
        }
        self.out = if gains.ramp == 0 {
            output
        } else {
            let step = output.saturating_sub(self.out);
            self.out
                .saturating_add(step.min(gains.ramp).max(-gains.ramp))
        };
        self.out
    }
}

/// value × gain, truncated toward zero, saturated.
///
/// The product is one of signed numbers, which a Cortex-M4 adds to 64 bits in the same instruction: to the bits
/// that a gain beyond their range lacks, and to what [`toward_zero`] tells.
#[inline]
fn unsigned_term(value: i32, gain: u32) -> i32 {
    let gain = gain as i32;
    let lacking = i64::from(value & (gain >> 31)) << 32;
    scaled::<GAIN_SHIFT>(lacking + toward_zero(value) + i64::from(value) * i64::from(gain))
}

/// The same for a signed gain.
#[inline]
fn signed_term(value: i32, gain: i32) -> i32 {
    scaled::<GAIN_SHIFT>(toward_zero(value ^ gain) + i64::from(value) * i64::from(gain))
}

/// What a product of this sign is moved up by, so that the shift, which rounds down, truncates it.
#[inline]
fn toward_zero(sign: i32) -> i64 {
    i64::from((sign >> 31) as u32 >> (32 - GAIN_SHIFT))
}
