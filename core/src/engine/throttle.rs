//! The drive in 10-bit throttle units: control law every 1 ms, ramp every 10 ms, limits every tick.
//!
//! Source: Talon SRX manual, 6, 8, 9, 17.5 to 17.8 and 18; order and decisions of `docs/talon-srx.md`.

use super::command::{Command, SensorSelect, SetAccumulator, Setpoint};
use super::output::unblocked;
use super::settings::Settings;
use super::snapshot::Snapshot;
use super::throttle_law::{Input, ThrottleLaw};
use crate::time::TICKS_PER_MS;
use crate::units::{Duty, THROTTLE_FULL};

/// Ticks from one step of the ramp to the next (manual 17.6: 10 ms).
const RAMP_TICKS: u8 = (10 * TICKS_PER_MS) as u8;

/// State of the drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ThrottleDrive {
    law: ThrottleLaw,
    /// The law rests in this tick: it works in every second one, the first of a closed loop included.
    rests: bool,
    ramp_wait: u8,
    applied: i32,
    set_generation: u32,
}

impl ThrottleDrive {
    pub(super) const fn new() -> Self {
        Self {
            law: ThrottleLaw::new(),
            rests: false,
            ramp_wait: 0,
            applied: 0,
            set_generation: 0,
        }
    }

    /// The loop begins anew, as on a change of mode.
    pub(super) fn restart_loop(&mut self) {
        self.law = ThrottleLaw::new();
        self.rests = false;
    }

    /// The output is off: neutral at once, without a ramp.
    pub(super) fn reset(&mut self) {
        self.restart_loop();
        self.ramp_wait = 0;
        self.applied = 0;
    }

    /// Sum of errors of the closed loop.
    pub(super) const fn accumulator(&self) -> i32 {
        self.law.accumulator()
    }

    /// Carries out an order to overwrite the sum of errors. A loop that begins clears it anyway.
    pub(super) fn obey(&mut self, command: &Command) {
        let order = command.set_accumulator;
        if order.generation != self.set_generation {
            self.set_accumulator(order);
        }
    }

    // Not inlined, see `Follower::wait`.
    #[inline(never)]
    fn set_accumulator(&mut self, order: SetAccumulator) {
        self.set_generation = order.generation;
        self.law.set_accumulator(order.value);
    }

    /// One tick of a running drive: the duty cycle; shows the error of a closed loop. `master` is the duty
    /// cycle to copy while following, nothing once its reports have stopped.
    pub(super) fn drive(
        &mut self,
        settings: &Settings,
        command: &Command,
        setpoint: Setpoint,
        master: Option<Duty>,
        shown: &mut Snapshot,
    ) -> Duty {
        let reverse = command.opts.reverse_motor;
        let (wanted, error) = match setpoint {
            Setpoint::Duty(duty) => (Some(duty.throttle()), 0),
            Setpoint::Position(target) => {
                self.closed_loop(settings, command, target, shown.position)
            }
            Setpoint::Velocity(target) => {
                self.closed_loop(settings, command, target, shown.velocity)
            }
            Setpoint::Follow(_) => {
                let turned = |duty: Duty| {
                    if reverse {
                        -duty.throttle()
                    } else {
                        duty.throttle()
                    }
                };
                (master.map(turned), 0)
            }
            // Not driven by this law.
            Setpoint::Off
            | Setpoint::Neutral
            | Setpoint::Pulse
            | Setpoint::Current(_)
            | Setpoint::Voltage(_) => (None, 0),
        };
        shown.error = error;
        shown.current_limited = false;
        let Some(wanted) = wanted else {
            self.reset();
            return Duty::ZERO;
        };
        let ramped = self.ramped(wanted, i32::from(command.opts.ramp));
        self.applied = unblocked(ramped, &mut shown.limits);
        Duty::from_throttle(self.applied)
    }

    /// The law's output and error, from the latest step.
    fn closed_loop(
        &mut self,
        settings: &Settings,
        command: &Command,
        target: i32,
        measured: i32,
    ) -> (Option<i32>, i32) {
        if !self.rests {
            let input = Input {
                target,
                measured,
                applied: self.applied,
                reverse: command.opts.reverse_motor,
                one_direction: command.opts.sensor == SensorSelect::RisingEdges,
            };
            self.law
                .step(settings.throttle_slot(command.opts.slot), &input);
        }
        self.rests = !self.rests;
        // A power of two first, which is one instruction (SSAT) on a Cortex-M.
        let throttle = self.law.out().clamp(-THROTTLE_FULL - 1, THROTTLE_FULL);
        let throttle = throttle.max(-THROTTLE_FULL);
        (Some(throttle), self.law.error())
    }

    /// The applied throttle moved towards `wanted` by at most `ramp` in 10 ms; 0 = at once.
    fn ramped(&mut self, wanted: i32, ramp: i32) -> i32 {
        self.ramp_wait = self.ramp_wait.saturating_sub(1);
        if ramp == 0 {
            return wanted;
        }
        if self.ramp_wait > 0 {
            return self.applied;
        }
        self.ramp_wait = RAMP_TICKS;
        self.applied + (wanted - self.applied).min(ramp).max(-ramp)
    }
}
