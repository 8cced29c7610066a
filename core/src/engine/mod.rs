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
mod scale;
pub mod sensor;
pub mod settings;
pub mod snapshot;
mod throttle;
pub mod throttle_law;

#[cfg(test)]
mod tests;

use command::{Command, Neutral, Setpoint};
use fault::FaultMonitor;
use limit::{judge, switches_hit};
use mode::{Event, Follower, Liveness, PulseInput, mode_of, transition};
use output::Output;
use pidf::{Pidf, Unit};
use scale::scaled;
use sensor::Sensors;
use settings::Law;
pub use settings::{Board, Policy, Settings};
use snapshot::{Actuation, DriveState, Sample, Snapshot};
use throttle::ThrottleDrive;

use crate::units::{Amps, Duty, Volts};

/// State of the control engine of one motor.
#[derive(Clone, Debug)]
pub struct Engine {
    /// What the tick before made of it all. What seldom changes is written only then.
    snapshot: Snapshot,
    /// Revision of the command that has been looked at.
    revision: u32,
    /// Setpoint in force.
    setpoint: Setpoint,
    /// It is the command's, which has been kept alive.
    in_force: bool,
    /// Neutral behaviour of the command, as long as it has not timed out.
    neutral: Option<Neutral>,
    /// Nothing has been driven since the control laws were reset.
    rests: bool,
    sensors: Sensors,
    faults: FaultMonitor,
    liveness: Liveness,
    follower: Follower,
    pulse: PulseInput,
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
            snapshot: Snapshot::new(),
            // Not the number that a first command is likely to have.
            revision: u32::MAX,
            setpoint: Setpoint::Off,
            in_force: false,
            neutral: None,
            rests: false,
            sensors: Sensors::new(),
            faults: FaultMonitor::new(),
            liveness: Liveness::new(),
            follower: Follower::new(),
            pulse: PulseInput::new(),
            law: Pidf::new(),
            output: Output::new(),
            throttle: ThrottleDrive::new(),
        }
    }

    /// One control tick. Must be called every 500 µs; the actuation in the snapshot is to be given to the
    /// bridge at once.
    ///
    /// `settings`, `sample` and `command` may be anything: no input panics, and the duty cycle never
    /// leaves the effective limits. A changed `command` counts from the tick that sees a new
    /// [`Command::revision`].
    pub fn tick(&mut self, settings: &Settings, sample: &Sample, command: &Command) -> &Snapshot {
        self.pulse.update(sample.pulse, &mut self.snapshot);
        if command.revision != self.revision {
            self.obey(settings, command);
        } else if let Some(event) = self.liveness.update(command, self.snapshot.pulse_valid) {
            self.snapshot.state = transition(self.snapshot.state, event);
            if self.liveness.is_in_force() != self.in_force {
                self.put_in_force(settings, command);
            }
        }
        self.snapshot.pins = sample.pins;
        let switch_hit = switches_hit(&settings.limits, sample.pins.limits());
        self.sensors
            .update(settings, sample, switch_hit, &mut self.snapshot);
        if self.snapshot.state == DriveState::SelfCheck {
            self.check(settings, sample, command);
        }
        self.faults.update(settings, sample, &mut self.snapshot);

        self.snapshot.limits = judge(
            &settings.limits,
            command.opts.limits,
            switch_hit,
            self.snapshot.position,
        );
        self.snapshot.neutral = self.neutral.unwrap_or(settings.neutral);
        if self.snapshot.state == DriveState::Running && !self.faults.stops() {
            self.rests = false;
            self.drive(settings, command);
        } else {
            self.rest();
        }
        &self.snapshot
    }

    /// A command that has changed.
    #[inline(never)]
    fn obey(&mut self, settings: &Settings, command: &Command) {
        self.revision = command.revision;
        self.sensors.obey(&settings.policy, command);
        let pulse_valid = self.snapshot.pulse_valid;
        if let Some(event) = self.liveness.obey(&settings.policy, command, pulse_valid) {
            self.snapshot.state = transition(self.snapshot.state, event);
        }
        self.put_in_force(settings, command);
    }

    /// Takes over what the command is by now: setpoint and options in force.
    #[inline(never)]
    fn put_in_force(&mut self, settings: &Settings, command: &Command) {
        self.in_force = self.liveness.is_in_force();
        self.setpoint = self.liveness.setpoint(command);
        self.follower
            .obey(&settings.policy, self.setpoint, command.master);
        self.neutral = command
            .opts
            .neutral
            .filter(|_| !self.liveness.has_expired());
        self.snapshot.opts = command.opts;
        let mode = mode_of(self.setpoint);
        if mode != self.snapshot.mode {
            self.snapshot.mode = mode;
            self.law.reset();
            self.throttle.restart_loop();
            self.snapshot.accumulator = self.throttle.accumulator();
        }
    }

    /// One tick of the self-check, which ends when the zero of the current sensor has been found. Until the tick
    /// after that no current is shown.
    #[inline(never)]
    fn check(&mut self, settings: &Settings, sample: &Sample, command: &Command) {
        self.snapshot.current = Amps::ZERO;
        if !self.sensors.find_zero(sample) {
            return;
        }
        let state = transition(self.snapshot.state, Event::Ready);
        // A command that came during the self-check and is still alive counts from now on.
        let standing = self.liveness.standing(&settings.policy, command);
        self.snapshot.state = standing.map_or(state, |event| transition(state, event));
    }

    /// Nothing is driven, and the control laws will begin anew. The terminals float while there is a fault and in
    /// the self-check; a drive that is only halted has its neutral behaviour.
    #[inline]
    fn rest(&mut self) {
        if !self.rests {
            self.rests = true;
            self.law.reset();
            self.output.reset();
            self.throttle.reset();
            self.snapshot.accumulator = self.throttle.accumulator();
            self.snapshot.error = 0;
            self.snapshot.current_limited = false;
        }
        if matches!(self.setpoint, Setpoint::Follow(_)) {
            self.follower.wait();
        }
        let snapshot = &mut self.snapshot;
        snapshot.actuation = if snapshot.state == DriveState::Halted && !self.faults.stops() {
            actuate(Duty::ZERO, snapshot.neutral)
        } else {
            Actuation::Off
        };
    }

    /// A running drive: setpoint, control law, and what the output makes of it.
    #[inline]
    fn drive(&mut self, settings: &Settings, command: &Command) {
        if settings.policy.law == Law::Throttle && self.setpoint != Setpoint::Pulse {
            self.drive_throttle(settings, command);
            return;
        }
        let opts = &command.opts;
        let snapshot = &mut self.snapshot;
        let closed = match self.setpoint {
            Setpoint::Velocity(target) => Some((target, snapshot.velocity, Unit::Count)),
            Setpoint::Position(target) => Some((target, snapshot.position, Unit::Count)),
            Setpoint::Current(target) => {
                // The setpoint's direction is the motor's: with reversed terminals the current that
                // serves it is negative, and without this the loop would run away.
                let current = snapshot.current.to_bits();
                let current = if opts.reverse_motor {
                    current.wrapping_neg()
                } else {
                    current
                };
                Some((target.to_bits(), current, Unit::Fixed))
            }
            _ => None,
        };
        let (asked, shaped) = match closed {
            Some((target, value, unit)) => {
                let slot = settings.slot(opts.slot);
                let error = target.saturating_sub(value);
                snapshot.error = error;
                let asked = self.law.step(&slot.gains, target, error, unit);
                let asked = turned(asked, opts.reverse_motor);
                let beyond = error.wrapping_abs() > slot.gains.allowable_error;
                (asked, self.output.closed_loop(asked, slot, beyond))
            }
            None => {
                snapshot.error = 0;
                let bus_voltage = snapshot.bus_voltage;
                let (asked, ramp) = match self.setpoint {
                    Setpoint::Duty(duty) => (i32::from(duty.units()), opts.ramp),
                    Setpoint::Voltage(target) => (compensate(target, bus_voltage), opts.ramp),
                    Setpoint::Follow(_) => {
                        self.follower.wait();
                        (i32::from(self.follower.duty().units()), opts.ramp)
                    }
                    Setpoint::Pulse => (i32::from(self.pulse.duty().units()), 0),
                    _ => (0, opts.ramp),
                };
                let asked = turned(asked, opts.reverse_motor);
                (asked, self.output.open_loop(asked, ramp))
            }
        };
        let duty = self.output.apply(settings, shaped, snapshot);
        snapshot.actuation = actuate(duty, snapshot.neutral);
        match self.setpoint {
            Setpoint::Duty(_) => {
                snapshot.error = i32::from(asked.units()) - i32::from(duty.units());
            }
            Setpoint::Voltage(target) => {
                snapshot.error = voltage_error(target, snapshot.bus_voltage, duty);
            }
            _ => {}
        }
    }

    #[inline(never)]
    fn drive_throttle(&mut self, settings: &Settings, command: &Command) {
        self.throttle.obey(command);
        let setpoint = self.setpoint;
        if matches!(setpoint, Setpoint::Follow(_)) {
            self.follower.wait();
        }
        let master = self.follower.report();
        let duty = self
            .throttle
            .drive(settings, command, setpoint, master, &mut self.snapshot);
        self.snapshot.accumulator = self.throttle.accumulator();
        self.snapshot.actuation = actuate(duty, self.snapshot.neutral);
    }
}

/// What a law or a setpoint asks for, saturated, at the terminals.
fn turned(duty: i32, reverse_motor: bool) -> Duty {
    let duty = Duty::saturating(duty);
    if reverse_motor { duty.reversed() } else { duty }
}

/// What the bridge does with a duty cycle.
const fn actuate(duty: Duty, neutral: Neutral) -> Actuation {
    match (duty, neutral) {
        (Duty::ZERO, Neutral::Brake) => Actuation::Brake,
        (Duty::ZERO, Neutral::Coast) => Actuation::Off,
        (duty, _) => Actuation::Drive(duty),
    }
}

/// The duty cycle that gives `target` volts at the terminals with the present bus voltage (16.16 V),
/// saturated. Without any bus voltage every target is out of reach: full duty cycle.
fn compensate(target: Volts, bus_voltage: Volts) -> i32 {
    // ±128 V (the 8.16 field of the control frame) keeps the numerator within 31 bits.
    const LIMIT: i32 = (1 << 23) - 1;
    let numerator = target.to_bits().clamp(-LIMIT, LIMIT) << 7;
    let bus_voltage = (bus_voltage.to_bits() >> 8).max(1);
    numerator / bus_voltage
}

/// Target minus what is applied, in 16.16 volts.
fn voltage_error(target: Volts, bus_voltage: Volts, duty: Duty) -> i32 {
    let product = i64::from(bus_voltage.to_bits()) * i64::from(duty.units());
    target.to_bits().saturating_sub(scaled::<15>(product))
}
