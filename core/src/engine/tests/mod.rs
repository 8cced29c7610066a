//! Tests of the engine as a whole: ticks in, actuations out. The motor is not simulated here; samples are
//! set by hand.

mod current;
mod drive;
mod limits;
mod properties;
mod sensors;
mod throttle;
mod throttle_law;
mod times;

use super::command::*;
use super::limit::Directions;
use super::settings::Policy;
use super::snapshot::*;
use super::*;
use crate::params::table::ParameterId;
use crate::params::{Params, compile};
use crate::units::{Amps, Duty};

/// The rules of the DMC60C guide: heartbeat and follower 104 ms, fault state 3 s.
const POLICY: Policy = Policy {
    command_timeout_ticks: 208,
    master_timeout_ticks: 208,
    fault_hold_ticks: 6000,
    resume: settings::Resume::NonZeroSetpoint,
    ..Policy::BASE
};

/// An engine past its self-check, with everything a test needs to turn knobs.
#[derive(Clone)]
pub(super) struct Rig {
    pub(super) engine: Engine,
    pub(super) params: Params,
    pub(super) policy: Policy,
    pub(super) sample: Sample,
    pub(super) command: Command,
    /// The command of the tick before: whatever a test changes in it is a revision.
    told: Command,
    pub(super) snapshot: Snapshot,
}

impl Rig {
    pub(super) fn new() -> Self {
        let mut rig = Self::cold();
        for _ in 0..64 {
            rig.tick();
        }
        assert_eq!(rig.snapshot.state, DriveState::Halted);
        rig
    }

    /// An engine at power-on.
    pub(super) fn cold() -> Self {
        Self {
            engine: Engine::new(),
            params: Params::new(),
            policy: POLICY,
            sample: Sample {
                current: 2048,
                bus_voltage: volts(12.0),
                temperature: celsius(25.0),
                ..Sample::default()
            },
            command: Command::default(),
            told: Command::default(),
            snapshot: Snapshot::default(),
        }
    }

    pub(super) fn set(&mut self, id: ParameterId, value: i32) -> &mut Self {
        self.params.set(id, value as u32).unwrap();
        self
    }

    pub(super) fn tick(&mut self) -> i16 {
        let settings = compile::settings(&self.params, &Board::REFERENCE, &self.policy);
        self.command.revision = self.told.revision;
        if self.command != self.told {
            self.command.revision += 1;
            self.told = self.command;
        }
        self.snapshot = *self.engine.tick(&settings, &self.sample, &self.command);
        self.snapshot.duty().units()
    }

    pub(super) fn ticks(&mut self, count: usize) -> i16 {
        for _ in 0..count {
            self.tick();
        }
        self.snapshot.duty().units()
    }

    /// A control frame arrives.
    pub(super) fn send(&mut self, setpoint: Setpoint) -> &mut Self {
        self.command.setpoint = setpoint;
        self.command.sequence += 1;
        self
    }

    pub(super) fn duty(&mut self, units: i16) -> &mut Self {
        self.send(Setpoint::Duty(Duty::new(units)))
    }

    /// Drives for `count` ticks with a control frame before each.
    pub(super) fn drive(&mut self, setpoint: Setpoint, count: usize) -> i16 {
        for _ in 0..count {
            self.send(setpoint).tick();
        }
        self.snapshot.duty().units()
    }

    pub(super) fn encoder(&mut self, counts: i32) -> &mut Self {
        self.sample.encoder = counts as u32;
        self
    }

    pub(super) fn amperes(&mut self, amperes: f64) -> &mut Self {
        let step = f64::from(self.params.signed(ParameterId::CurrentMultiplier)) / 65536.0;
        self.sample.current = (2048.0 + amperes / step) as u16;
        self
    }
}

/// The conversion of a bus voltage on the reference board (36.3 V full scale).
pub(super) fn volts(volts: f64) -> u16 {
    (volts / 36.3 * 4096.0 + 0.5) as u16
}

/// The conversion of a temperature on the reference board (0.5 V at 0 °C, 10 mV/°C, 3.3 V full scale).
pub(super) fn celsius(celsius: f64) -> u16 {
    ((celsius * 0.01 + 0.5) / 3.3 * 4096.0 + 0.5) as u16
}
