//! Current limiting: a cap on the size of the duty cycle, found by a control law on the current.
//!
//! Limiting begins when the current has been above its threshold for longer than the peak duration, and
//! ends when the request has stayed below the cap for 10 ms or the output is off. Between the two the cap
//! is the law's output for (continuous limit − size of the current), with the integral part preloaded so
//! that the first cap equals the duty cycle just applied. Source: DMC60C guide,
//! `paramContinuousCurrentLimit` to `paramPeakCurrentDuration`; `docs/dmc60c.md` for begin and end.

use super::pidf::{operand, product};
use super::settings::CurrentLimit;
use crate::time::TICKS_PER_MS;

/// The request must stay below the cap this long before limiting ends.
const END_AFTER_TICKS: u16 = (10 * TICKS_PER_MS) as u16;

/// The integral part never leaves ± this (512 times full throttle in 32.32).
const INTEGRAL_LIMIT: i64 = 1 << 56;

/// Full throttle as a cap.
const FULL: i32 = 32768;

#[derive(Clone, Copy, Debug, Default)]
struct Active {
    /// Integral part of the cap, 32.32 throttle units: gain and accumulator in one, so that the preload
    /// needs no division.
    integral: i64,
    /// The integral part stays within ± this.
    bound: i64,
    previous_error: i32,
    ticks_below: u16,
}

/// State of the current limiter.
#[derive(Clone, Copy, Debug, Default)]
pub struct CurrentLimiter {
    ticks_above: u32,
    active: Option<Active>,
}

impl CurrentLimiter {
    /// Not limiting.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            ticks_above: 0,
            active: None,
        }
    }

    /// Forgets everything: the output is off.
    pub fn reset(&mut self) {
        // Field by field: what lies in `active` need not be overwritten.
        self.ticks_above = 0;
        self.active = None;
    }

    /// One tick. `current` is the size of the current in 16.16 A, `applied` the size of the duty cycle
    /// of the tick before, `requested` the size of the one asked for now. Gives the cap while limiting.
    pub fn cap(
        &mut self,
        settings: &CurrentLimit,
        current: i32,
        applied: i32,
        requested: i32,
    ) -> Option<i32> {
        if !settings.enabled {
            self.reset();
            return None;
        }
        if self.active.is_some() {
            return self.hold(settings, current, requested);
        }
        if current <= settings.begin_above {
            self.ticks_above = 0;
            return None;
        }
        self.ticks_above = self.ticks_above.saturating_add(1);
        if self.ticks_above <= settings.begin_after_ticks {
            return None;
        }
        let error = error(settings, current);
        let active = self.active.insert(Active::begin(settings, error, applied));
        Some(active.output(settings, error, 0))
    }

    /// One tick of limiting.
    fn hold(&mut self, settings: &CurrentLimit, current: i32, requested: i32) -> Option<i32> {
        let active = self.active.as_mut()?;
        let cap = active.step(settings, error(settings, current));
        active.ticks_below = if requested < cap {
            active.ticks_below.saturating_add(1)
        } else {
            0
        };
        if active.ticks_below >= END_AFTER_TICKS {
            self.reset();
            return None;
        }
        Some(cap)
    }
}

/// Continuous limit minus size of the current.
fn error(settings: &CurrentLimit, current: i32) -> i32 {
    operand(settings.continuous.wrapping_sub(current))
}

impl Active {
    fn begin(settings: &CurrentLimit, error: i32, applied: i32) -> Self {
        let gains = &settings.gains;
        // Nothing here overflows: two products of 2⁶² at most, one of 2⁵⁹ and a duty cycle of 2⁴⁷.
        let zone = product(gains.i, gains.accumulator_limit).wrapping_abs();
        let mut integral = 0;
        if gains.i != 0 {
            let wanted = i64::from(applied) << 32;
            integral = wanted
                .wrapping_sub(product(gains.p, error))
                .wrapping_sub(product(gains.f, settings.continuous))
                .clamp(-INTEGRAL_LIMIT, INTEGRAL_LIMIT);
        }
        // The zone limits what is accumulated, not what was preloaded: otherwise a motor that was limited
        // at high speed could never get its duty cycle back.
        let bound = zone.max(integral.wrapping_abs()).min(INTEGRAL_LIMIT);
        Self {
            integral,
            bound,
            previous_error: error,
            ticks_below: 0,
        }
    }

    fn step(&mut self, settings: &CurrentLimit, error: i32) -> i32 {
        // At most 2⁵⁶ and a product of 2⁵⁹.
        let added = self.integral.wrapping_add(product(settings.gains.i, error));
        self.integral = added.min(self.bound).max(-self.bound);
        let change = error.wrapping_sub(self.previous_error);
        self.previous_error = error;
        self.output(settings, error, change)
    }

    fn output(&self, settings: &CurrentLimit, error: i32, change: i32) -> i32 {
        let gains = &settings.gains;
        let sum = self
            .integral
            .wrapping_add(product(gains.p, error))
            .wrapping_add(product(gains.d, change))
            .wrapping_add(product(gains.f, settings.continuous));
        ((sum >> 32) as i32).clamp(0, FULL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::pidf::Gains;

    const AMPERE: i32 = 1 << 16;

    fn settings() -> CurrentLimit {
        CurrentLimit {
            enabled: true,
            begin_above: 60 * AMPERE,
            begin_after_ticks: 1000,
            continuous: 40 * AMPERE,
            gains: Gains {
                p: 0x0064_0000,
                i: 0x003C_0000,
                d: 0,
                f: 0,
                accumulator_limit: 0x014C_C888,
                allowable_error: 0,
            },
        }
    }

    #[test]
    fn limiting_begins_after_the_peak_duration_without_a_break() {
        let mut limiter = CurrentLimiter::default();
        for _ in 0..999 {
            assert_eq!(limiter.cap(&settings(), 61 * AMPERE, 20_000, 20_000), None);
        }
        assert_eq!(limiter.cap(&settings(), 60 * AMPERE, 20_000, 20_000), None);
        for _ in 0..1000 {
            assert_eq!(limiter.cap(&settings(), 61 * AMPERE, 20_000, 20_000), None);
        }
        assert_eq!(
            limiter.cap(&settings(), 61 * AMPERE, 20_000, 20_000),
            Some(20_000)
        );
    }

    #[test]
    fn duration_zero_begins_at_the_first_sample_above_peak() {
        let now = CurrentLimit {
            begin_after_ticks: 0,
            ..settings()
        };
        let mut limiter = CurrentLimiter::default();
        assert_eq!(limiter.cap(&now, 60 * AMPERE, 30_000, 30_000), None);
        assert_eq!(
            limiter.cap(&now, 60 * AMPERE + 1, 30_000, 30_000),
            Some(30_000)
        );
    }

    #[test]
    fn the_first_cap_is_the_applied_duty_even_above_the_zone_and_comes_back() {
        let now = CurrentLimit {
            begin_after_ticks: 0,
            ..settings()
        };
        let mut limiter = CurrentLimiter::default();
        assert_eq!(limiter.cap(&now, 61 * AMPERE, 32_000, 32_767), Some(32_000));
        let low = (0..20)
            .filter_map(|_| limiter.cap(&now, 61 * AMPERE, 0, 32_767))
            .last();
        assert!(low < Some(8000), "{low:?}");
        let high = (0..60)
            .filter_map(|_| limiter.cap(&now, 0, 0, 40_000))
            .last();
        assert_eq!(high, Some(32_768));
    }

    #[test]
    fn limiting_ends_after_10_ms_below_the_cap_and_the_peak_timer_starts_anew() {
        let mut limiter = CurrentLimiter::default();
        for _ in 0..1001 {
            limiter.cap(&settings(), 61 * AMPERE, 20_000, 20_000);
        }
        for _ in 0..19 {
            assert!(
                limiter
                    .cap(&settings(), 10 * AMPERE, 5_000, 5_000)
                    .is_some()
            );
        }
        assert_eq!(limiter.cap(&settings(), 10 * AMPERE, 5_000, 5_000), None);
        for _ in 0..1000 {
            assert_eq!(limiter.cap(&settings(), 61 * AMPERE, 20_000, 20_000), None);
        }
        assert!(
            limiter
                .cap(&settings(), 61 * AMPERE, 20_000, 20_000)
                .is_some()
        );
    }

    #[test]
    fn disabled_never_limits() {
        let off = CurrentLimit {
            enabled: false,
            begin_after_ticks: 0,
            ..settings()
        };
        let mut limiter = CurrentLimiter::default();
        for _ in 0..10 {
            assert_eq!(limiter.cap(&off, 64 * AMPERE, 32_767, 32_767), None);
        }
    }
}
