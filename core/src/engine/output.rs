//! From the requested duty cycle to the applied one: ramp, nominal and peak, current limit, derating,
//! hard and soft limits.

use super::current_limit::CurrentLimiter;
use super::sensor::Measured;
use super::settings::{Derating, Settings, SlotSettings};
use super::snapshot::LimitStatus;
use crate::units::Duty;

/// How a request is shaped.
pub(super) enum Shape<'a> {
    /// By the ramp of the command.
    OpenLoop {
        /// Throttle units per tick, 0 = at once.
        ramp: i32,
    },
    /// By the gain slot.
    ClosedLoop {
        slot: &'a SlotSettings,
        /// The error is large enough for the nominal duty cycle.
        nominal: bool,
    },
}

/// What setpoint and control law ask for.
pub(super) struct Request<'a> {
    /// After motor reversal.
    pub(super) duty: Duty,
    /// Target minus measured value of a closed loop.
    pub(super) error: i32,
    pub(super) shape: Shape<'a>,
}

/// What limits the output in this tick.
pub(super) struct ActiveLimits {
    pub(super) forward: LimitStatus,
    pub(super) reverse: LimitStatus,
    pub(super) current_limited: bool,
}

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
        *self = Self::new();
    }

    /// Shapes one request; reports refused directions and current limiting in `limits`.
    pub(super) fn apply(
        &mut self,
        settings: &Settings,
        measured: &Measured,
        request: &Request<'_>,
        limits: &mut ActiveLimits,
    ) -> Duty {
        let requested = i32::from(request.duty.units());
        let mut duty = match request.shape {
            Shape::OpenLoop { ramp } => ramped(self.applied, requested, ramp),
            Shape::ClosedLoop { slot, nominal } => {
                let ramped = ramped(self.applied, requested, slot.ramp);
                let raised = if nominal {
                    raised(slot, requested, ramped)
                } else {
                    ramped
                };
                raised.min(slot.forward_max).max(slot.reverse_max)
            }
        };
        let cap = self.limiter.cap(
            &settings.current_limit,
            measured.current.saturating_abs(),
            self.applied.abs(),
            duty.abs(),
        );
        limits.current_limited = cap.is_some();
        let derated = settings.board.thresholds.derating.cap(measured.temperature);
        let cap = cap.unwrap_or(Derating::FULL).min(derated);
        duty = duty.min(cap).max(-cap);
        if duty > 0 && limits.forward.blocked {
            limits.forward.refused = true;
            duty = 0;
        }
        if duty < 0 && limits.reverse.blocked {
            limits.reverse.refused = true;
            duty = 0;
        }
        let duty = Duty::saturating(duty);
        self.applied = i32::from(duty.units());
        duty
    }
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
