//! From the requested duty cycle to the applied one: ramp, nominal and peak, current limit, derating,
//! hard and soft limits.

use super::current_limit::CurrentLimiter;
use super::sensor::Measured;
use super::settings::{Settings, SlotSettings, Thresholds};
use super::snapshot::Snapshot;
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

    /// Shapes one request; reports refused directions and current limiting in `snapshot`.
    pub(super) fn apply(
        &mut self,
        settings: &Settings,
        measured: &Measured,
        request: &Request<'_>,
        snapshot: &mut Snapshot,
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
        snapshot.current_limited = cap.is_some();
        let derated = derated(&settings.board.thresholds, measured.temperature);
        let cap = cap.unwrap_or(FULL).min(derated);
        duty = duty.min(cap).max(-cap);
        if duty > 0 && snapshot.forward.blocked {
            snapshot.forward.refused = true;
            duty = 0;
        }
        if duty < 0 && snapshot.reverse.blocked {
            snapshot.reverse.refused = true;
            duty = 0;
        }
        let duty = Duty::saturating(duty);
        self.applied = i32::from(duty.units());
        duty
    }
}

/// Full throttle as a cap.
const FULL: i32 = 32768;

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

/// Cap on the duty cycle for a case temperature (16.16 °C): full up to the derating temperature, then
/// falling to none at the over-temperature threshold.
fn derated(thresholds: &Thresholds, temperature: i32) -> i32 {
    if temperature <= thresholds.derate_from {
        return FULL;
    }
    let span = i64::from(thresholds.over_temperature) - i64::from(thresholds.derate_from);
    let left = i64::from(thresholds.over_temperature) - i64::from(temperature);
    if left <= 0 || span <= 0 {
        return 0;
    }
    // Both differences are below 2^32 and left < span, so the quotient is below FULL.
    (left * i64::from(FULL) / span) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::settings::Board;

    #[test]
    fn a_ramp_never_overshoots() {
        assert_eq!(ramped(5000, 10_000, 2500), 7500);
        assert_eq!(ramped(7500, 10_000, 2500), 10_000);
        assert_eq!(ramped(9999, 10_000, 2500), 10_000);
        assert_eq!(ramped(100, -100, 150), -50);
        assert_eq!(ramped(-32768, 32767, 0), 32767);
        assert_eq!(ramped(32767, -32768, i32::MAX), -32768);
    }

    #[test]
    fn derating_is_linear_from_85_to_105_degrees() {
        let at = |celsius: i32| derated(&Board::REFERENCE.thresholds, celsius << 16);
        assert_eq!(
            [at(84), at(85), at(90), at(95), at(105), at(150)],
            [32768, 32768, 24576, 16384, 0, 0]
        );
    }
}
