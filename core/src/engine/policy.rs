//! What differs between dialects in when and how a motor is driven, as data that the engine obeys.

use super::snapshot::Faults;

/// Which command ends the halted state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resume {
    /// Only one with a non-zero setpoint (DMC60C guide, "Output Control Protocol").
    #[default]
    NonZeroSetpoint,
    /// Any driving command.
    AnyCommand,
}

/// What allows the drive to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Enabling {
    /// Every driving command is its own permission. Its options are void once it has timed out.
    #[default]
    WithCommand,
    /// A permission of its own, [`Command::enable`](super::command::Command::enable), has to be as fresh
    /// as the command. The drive runs exactly while both are, and options outlive the permission.
    Separate,
}

/// The control law with the resolution and the rhythm of what it drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Law {
    /// 16-bit duty cycle, law and ramp every 500 µs tick ([`super::pidf`]).
    #[default]
    PerTick,
    /// 10-bit throttle, law every 1 ms, ramp every 10 ms.
    Throttle,
}

/// The sensors that are followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SensorSet {
    /// The quadrature encoder.
    #[default]
    Encoder,
    /// Every sensor at all times, one of them being selected by the command.
    All,
}

/// Where a soft limit begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SoftThreshold {
    /// At the threshold (DMC60C guide, `paramLimitSoftFwdThreshold`).
    #[default]
    Inclusive,
    /// Beyond the threshold (Talon SRX manual, 8).
    Exclusive,
}

/// What makes a fault sticky.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sticky {
    /// Its beginning: a fault that is present while the sticky ones are cleared does not come back.
    #[default]
    Beginning,
    /// Its presence, and that of a limit: a fault that is still present is sticky again at once.
    Presence,
}

/// Thresholds of a dialect that shows a condition instead of the board's, which stop the drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Indicated {
    /// Bus voltage below this, 16.16 V.
    pub under_voltage: i32,
    /// Case temperature from this on, 16.16 °C.
    pub over_temperature: i32,
    /// Ticks that either must last.
    pub ticks: u16,
}

/// When the drive stops by itself and when it goes on: the part of a dialect that the engine obeys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Policy {
    /// Ticks without a driving command, or without its permission, after which the output is switched off.
    pub command_timeout_ticks: u16,
    /// Ticks without a report of the followed controller after which the duty cycle is zero.
    pub master_timeout_ticks: u16,
    /// Ticks that a fault keeps the output off after it was last seen.
    pub fault_hold_ticks: u16,
    /// What ends the halted state.
    pub resume: Resume,
    /// What allows the drive to run.
    pub enabling: Enabling,
    /// Control law.
    pub law: Law,
    /// Sensors.
    pub sensors: SensorSet,
    /// Where soft limits begin.
    pub soft_threshold: SoftThreshold,
    /// Faults that switch the output off; the others are only shown.
    pub stopping: Faults,
    /// Thresholds of what is only shown; nothing where the board's count. With them the duty cycle is not
    /// derated towards the board's limit either.
    pub indicated: Option<Indicated>,
    /// What makes a fault sticky.
    pub sticky: Sticky,
    /// Ticks that the output is off after the type of a limit switch or the stored neutral behaviour has
    /// been changed.
    pub pause_ticks: u16,
}

impl Policy {
    /// Commands carry their own permission, every fault stops for 3 s, heartbeats last 104 ms, and the law
    /// works every tick: what a dialect has unless it says otherwise.
    pub const BASE: Self = Self {
        command_timeout_ticks: 208,
        master_timeout_ticks: 208,
        fault_hold_ticks: 6000,
        resume: Resume::NonZeroSetpoint,
        enabling: Enabling::WithCommand,
        law: Law::PerTick,
        sensors: SensorSet::Encoder,
        soft_threshold: SoftThreshold::Inclusive,
        stopping: Faults::ALL,
        indicated: None,
        sticky: Sticky::Beginning,
        pause_ticks: 0,
    };
}
