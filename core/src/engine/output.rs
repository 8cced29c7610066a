//! From the requested duty cycle to the applied one: ramp, nominal and peak, current limit, derating,
//! hard and soft limits.

use super::current_limit::CurrentLimiter;
use super::limit::Directions;
use super::settings::{Settings, SlotSettings};
use super::snapshot::{LimitStatus, Snapshot};
use crate::units::Duty;

/// State of the output. Its ramp starts from the applied value, so whatever limits the output also holds
/// the ramp, and a release is never a jump.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Output {
    applied: i32,
    limiter: CurrentLimiter,
}

impl Output {
    pub(super) const fn new() -> Self {
        Self {
            applied: 0,
            limiter: CurrentLimiter::new(),
        }
    }

    /// The output is off: the next ramp starts at zero.
    pub(super) fn reset(&mut self) {
        self.applied = 0;
        self.limiter.reset();
    }

    /// A request of an open loop: `ramp` throttle units per tick, 0 = at once.
    #[inline]
    pub(super) fn open_loop(&self, requested: Duty, ramp: u16) -> i32 {
        ramped(self.applied, i32::from(requested.units()), i32::from(ramp))
    }

    /// A request of a closed loop, shaped by its gain slot. `nominal`: the error is large enough for the
    /// nominal duty cycle.
    #[inline]
    pub(super) fn closed_loop(&self, requested: Duty, slot: &SlotSettings, nominal: bool) -> i32 {
        let requested = i32::from(requested.units());
        let ramped = ramped(self.applied, requested, slot.ramp);
        let raised = if nominal {
            raised(slot, requested, ramped)
        } else {
            ramped
        };
        raised.min(slot.forward_max).max(slot.reverse_max)
    }

    /// The shaped duty cycle as far as current, temperature and limits allow; shows what does not.
    #[inline]
    pub(super) fn apply(&mut self, settings: &Settings, shaped: i32, shown: &mut Snapshot) -> Duty {
        let mut duty = shaped;
        let cap = if settings.current_limit.enabled {
            self.limiter.cap(
                &settings.current_limit,
                shown.current.to_bits().saturating_abs(),
                self.applied.abs(),
                shaped.abs(),
            )
        } else {
            self.limiter.reset();
            None
        };
        shown.current_limited = cap.is_some();
        if let Some(cap) = cap {
            duty = duty.min(cap).max(-cap);
        }
        let temperature = shown.temperature.to_bits();
        let derating = &settings.board.thresholds.derating;
        if derating.acts(temperature) {
            let cap = derating.cap(temperature);
            duty = duty.min(cap).max(-cap);
        }
        if !shown.limits.blocked.is_empty() {
            duty = unblocked(duty, &mut shown.limits);
        }
        let duty = Duty::saturating(duty);
        self.applied = i32::from(duty.units());
        duty
    }
}

/// The duty cycle unless its direction is blocked; then zero, and the direction shows as refused.
#[inline]
pub(super) fn unblocked(duty: i32, limits: &mut LimitStatus) -> i32 {
    let wanted = Directions::new(duty > 0, duty < 0);
    let refused = wanted.intersection(limits.blocked);
    if refused.is_empty() {
        return duty;
    }
    limits.refused = refused;
    0
}

/// `from` moved towards `to` by at most `rate`; 0 = at once.
fn ramped(from: i32, to: i32, rate: i32) -> i32 {
    if rate == 0 {
        to
    } else {
        from + (to - from).min(rate).max(-rate)
    }
}

/// At least the nominal duty cycle of the requested direction, once the output has that direction.
///
/// While the ramp still crosses the other direction nothing is raised: it would hold the output there.
fn raised(slot: &SlotSettings, requested: i32, duty: i32) -> i32 {
    if requested > 0 && duty > 0 {
        duty.max(slot.forward_nominal)
    } else if requested < 0 && duty < 0 {
        duty.min(slot.reverse_nominal)
    } else {
        duty
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_never_overshoots() {
        assert_eq!(ramped(5000, 10_000, 2500), 7500);
        assert_eq!(ramped(7500, 10_000, 2500), 10_000);
        assert_eq!(ramped(9999, 10_000, 2500), 10_000);
        assert_eq!(ramped(100, -100, 150), -50);
        assert_eq!(ramped(-32768, 32767, 0), 32767);
        assert_eq!(ramped(32767, -32768, i32::MAX), -32768);
    }
}
