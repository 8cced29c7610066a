//! The control engine: one [`Engine::tick`] every 500 µs turns a sample and a command into what the
//! bridge does.
//!
//! Order of a tick: sample → faults → liveness → mode and setpoint → control law → motor reversal → ramp
//! → nominal and peak → current limit and derating → hard and soft limits → bridge. Everything is
//! fixed-point integer arithmetic without a panic path: the same inputs give the same outputs, bit for
//! bit, on every machine.
//!
//! The engine knows no dialect. What differs between dialects is data: [`settings::Policy`].

pub mod command;
pub mod current_limit;
pub mod fault;
pub mod limit;
pub mod mode;
pub mod other_sensors;
mod output;
pub mod pidf;
pub mod policy;
pub mod sensor;
pub mod settings;
pub mod snapshot;
mod throttle;
pub mod throttle_law;

#[cfg(test)]
mod tests;

use command::{Command, Neutral, Setpoint};
use fault::FaultMonitor;
use limit::{Direction, judge};
use mode::{Event, Follower, Liveness, PulseInput, mode_of, transition};
use output::{ActiveLimits, Output, Request, Shape};
use pidf::{Pidf, Unit};
use sensor::{Measured, Sensors};
use settings::Law;
pub use settings::{Board, Policy, Settings};
use snapshot::{Actuation, DriveState, Mode, Sample, Snapshot};
use throttle::ThrottleDrive;

use crate::units::{Amps, Celsius, Duty, Volts};

/// State of the control engine of one motor.
#[derive(Clone, Debug)]
pub struct Engine {
    sensors: Sensors,
    faults: FaultMonitor,
    liveness: Liveness,
    follower: Follower,
    pulse: PulseInput,
    state: DriveState,
    mode: Mode,
    law: Pidf,
    output: Output,
    throttle: ThrottleDrive,
}

impl Default for Engine {
    fn default() -> Self {
        Self::new()
    }
}

impl Engine {
    /// An engine at power-on: output off, in its self-check.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            sensors: Sensors::new(),
            faults: FaultMonitor::new(),
            liveness: Liveness::new(),
            follower: Follower::new(),
            pulse: PulseInput::new(),
            state: DriveState::SelfCheck,
            mode: Mode::Off,
            law: Pidf::new(),
            output: Output::new(),
            throttle: ThrottleDrive::new(),
        }
    }

    /// One control tick. Must be called every 500 µs; the actuation in the snapshot is to be given to the
    /// bridge at once.
    ///
    /// `settings`, `sample` and `command` may be anything: no input panics, and the duty cycle never
    /// leaves the effective limits.
    pub fn tick(&mut self, settings: &Settings, sample: &Sample, command: &Command) -> Snapshot {
        let measured = self.sensors.update(settings, sample, command);
        self.faults.update(
            &settings.board.thresholds,
            &settings.policy,
            &measured,
            sample,
        );
        self.pulse.update(sample.pulse);
        self.advance_state(settings, command);

        let setpoint = self.liveness.setpoint(command);
        let mode = mode_of(setpoint);
        if mode != self.mode {
            self.mode = mode;
            self.law.reset();
            self.throttle.restart_loop();
        }
        let master = self
            .follower
            .update(&settings.policy, setpoint, command.master);

        let neutral = self.neutral(settings, command);
        let mut limits = judge_both(settings, command, sample, measured.position);
        let idle = self.state != DriveState::Running || self.faults.stops();
        let throttled = settings.policy.law == Law::Throttle;
        let (actuation, error) = if idle {
            self.law.reset();
            self.output.reset();
            if throttled {
                self.throttle.reset();
            }
            (self.idle(neutral), 0)
        } else if throttled && setpoint != Setpoint::Pulse {
            self.throttle.obey(command);
            let (duty, error) =
                self.throttle
                    .drive(settings, command, setpoint, master, &measured, &mut limits);
            (actuate(duty, neutral), error)
        } else {
            let master = master.unwrap_or(Duty::ZERO);
            let request = self.request(settings, command, setpoint, master, &measured);
            let duty = self
                .output
                .apply(settings, &measured, &request, &mut limits);
            let error = reported_error(setpoint, &request, duty, &measured);
            (actuate(duty, neutral), error)
        };

        Snapshot {
            mode,
            state: self.state,
            faults: self.faults.active(),
            fault_events: self.faults.events(),
            actuation,
            neutral,
            opts: command.opts,
            error,
            position: measured.position,
            velocity: measured.velocity,
            raw: *self.sensors.raw(),
            accumulator: self.throttle.accumulator(),
            current: Amps::from_bits(measured.current),
            bus_voltage: Volts::from_bits(measured.bus_voltage),
            temperature: Celsius::from_bits(measured.temperature),
            analog_in: Volts::from_bits(measured.analog_in),
            pins: sample.pins,
            forward: limits.forward,
            reverse: limits.reverse,
            current_limited: limits.current_limited,
            pulse_valid: self.pulse.is_valid(),
        }
    }

    /// What the bridge does while nothing is driven: floats unless the drive is halted, without a fault,
    /// and brakes at neutral.
    fn idle(&self, neutral: Neutral) -> Actuation {
        if self.state == DriveState::Halted && !self.faults.stops() {
            actuate(Duty::ZERO, neutral)
        } else {
            Actuation::Off
        }
    }

    fn advance_state(&mut self, settings: &Settings, command: &Command) {
        let event = self
            .liveness
            .update(&settings.policy, command, self.pulse.is_valid());
        if let Some(event) = event {
            self.state = transition(self.state, event);
        }
        if self.state == DriveState::SelfCheck && self.sensors.is_ready() {
            self.state = transition(self.state, Event::Ready);
            // A command that came during the self-check and is still alive counts from now on.
            if let Some(event) = self.liveness.standing(&settings.policy, command) {
                self.state = transition(self.state, event);
            }
        }
    }

    /// Neutral behaviour in force: the command's, as long as it has not timed out, else the stored one.
    fn neutral(&self, settings: &Settings, command: &Command) -> Neutral {
        match command.opts.neutral {
            Some(neutral) if !self.liveness.has_expired() => neutral,
            _ => settings.neutral,
        }
    }

    /// Setpoint and control law: the duty cycle asked for, before it is shaped.
    fn request<'a>(
        &mut self,
        settings: &'a Settings,
        command: &Command,
        setpoint: Setpoint,
        master: Duty,
        measured: &Measured,
    ) -> Request<'a> {
        let opts = &command.opts;
        let slot = settings.slot(opts.slot);
        let gains = &slot.gains;
        let mut closed_loop = |target: i32, value: i32, unit: Unit| {
            let error = target.saturating_sub(value);
            let output = self.law.step(gains, target, error, unit);
            let beyond = error.wrapping_abs() > gains.allowable_error;
            (
                output,
                error,
                Shape::ClosedLoop {
                    slot,
                    nominal: beyond,
                },
            )
        };
        let open_loop = Shape::OpenLoop {
            ramp: i32::from(opts.ramp),
        };
        let (duty, error, shape) = match setpoint {
            Setpoint::Off | Setpoint::Neutral => (0, 0, open_loop),
            Setpoint::Duty(duty) => (i32::from(duty.units()), 0, open_loop),
            Setpoint::Velocity(target) => closed_loop(target, measured.velocity, Unit::Count),
            Setpoint::Position(target) => closed_loop(target, measured.position, Unit::Count),
            Setpoint::Current(target) => {
                // The setpoint's direction is the motor's: with reversed terminals the current that
                // serves it is negative, and without this the loop would run away.
                let current = if opts.reverse_motor {
                    -measured.current
                } else {
                    measured.current
                };
                closed_loop(target.to_bits(), current, Unit::Fixed)
            }
            Setpoint::Voltage(target) => (compensate(target, measured.bus_voltage), 0, open_loop),
            Setpoint::Follow(_) => (i32::from(master.units()), 0, open_loop),
            Setpoint::Pulse => (
                i32::from(self.pulse.duty().units()),
                0,
                Shape::OpenLoop { ramp: 0 },
            ),
        };
        let duty = Duty::saturating(duty);
        let duty = if opts.reverse_motor {
            duty.reversed()
        } else {
            duty
        };
        Request { duty, error, shape }
    }
}

/// What the bridge does with a duty cycle.
const fn actuate(duty: Duty, neutral: Neutral) -> Actuation {
    match (duty, neutral) {
        (Duty::ZERO, Neutral::Brake) => Actuation::Brake,
        (Duty::ZERO, Neutral::Coast) => Actuation::Off,
        (duty, _) => Actuation::Drive(duty),
    }
}

/// Judges the limits of both directions.
fn judge_both(
    settings: &Settings,
    command: &Command,
    sample: &Sample,
    position: i32,
) -> ActiveLimits {
    let (over, pins) = (command.opts.limits, &sample.pins);
    ActiveLimits {
        forward: judge(
            Direction::Forward,
            &settings.forward,
            over,
            pins.forward_limit,
            position,
        ),
        reverse: judge(
            Direction::Reverse,
            &settings.reverse,
            over,
            pins.reverse_limit,
            position,
        ),
        current_limited: false,
    }
}

/// The duty cycle that gives `target` volts at the terminals with the present bus voltage (16.16 V),
/// saturated. Without any bus voltage every target is out of reach: full duty cycle.
fn compensate(target: Volts, bus_voltage: i32) -> i32 {
    // ±128 V (the 8.16 field of the control frame) keeps the numerator within 31 bits.
    const LIMIT: i32 = (1 << 23) - 1;
    let numerator = target.to_bits().clamp(-LIMIT, LIMIT) << 7;
    let bus_voltage = (bus_voltage >> 8).max(1);
    numerator / bus_voltage
}

/// The error that status frames show, see [`Snapshot::error`].
fn reported_error(
    setpoint: Setpoint,
    request: &Request<'_>,
    duty: Duty,
    measured: &Measured,
) -> i32 {
    match setpoint {
        Setpoint::Duty(_) => i32::from(request.duty.units()) - i32::from(duty.units()),
        Setpoint::Voltage(target) => {
            let product = i64::from(measured.bus_voltage) * i64::from(duty.units());
            let applied = (product >> 15).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
            target.to_bits().saturating_sub(applied)
        }
        _ => request.error,
    }
}
