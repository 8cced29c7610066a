//! What the engine is told to do: one complete, idempotent value.
//!
//! A [`Command`] holds everything that a control frame can say, so that a lost frame is repaired by the
//! next one and a repeated frame changes nothing. Only two things in it count: `sequence`, which tells
//! the engine that a driving frame arrived (it restarts the heartbeat), and the generation numbers of
//! one-shots. A third number, `revision`, only tells the engine where it need not look.

use super::limit::Directions;
use crate::units::{Amps, Duty, Volts};

/// Closed-loop gain set ("motor control profile slot" of the DMC60C guide).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Slot {
    /// Slot 0.
    #[default]
    Zero,
    /// Slot 1.
    One,
}

impl Slot {
    /// The slot's number, 0 or 1.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// What the bridge does with the motor terminals while the duty cycle is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Neutral {
    /// Both terminals shorted: the motor resists turning.
    #[default]
    Brake,
    /// Both terminals floating: the motor turns freely.
    Coast,
}

/// The quantity that is driven, with its target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Setpoint {
    /// Output off (DMC60C `modeNoDrive`).
    #[default]
    Off,
    /// Open-loop duty cycle.
    Duty(Duty),
    /// Closed loop on encoder velocity in counts per 100 ms.
    Velocity(i32),
    /// Closed loop on encoder position in counts.
    Position(i32),
    /// Closed loop on motor current.
    Current(Amps),
    /// Constant output voltage whatever the bus voltage is.
    Voltage(Volts),
    /// The duty cycle that another controller reports, see [`Command::master`]. The number tells which
    /// controller; when it changes, what the one before has reported is void.
    Follow(u8),
    /// The duty cycle that the RC-PWM input asks for; the source of drive while there is no CAN bus.
    Pulse,
    /// Nothing is driven although the drive may run: neutral, with the heartbeat going on.
    Neutral,
}

impl Setpoint {
    /// True where the guide speaks of "a non-zero setpoint", which is what ends the halted state.
    #[must_use]
    pub fn is_nonzero(self) -> bool {
        match self {
            Self::Off | Self::Neutral => false,
            Self::Duty(duty) => duty != Duty::ZERO,
            Self::Velocity(counts) | Self::Position(counts) => counts != 0,
            Self::Current(value) | Self::Voltage(value) => value != 0,
            Self::Follow(_) | Self::Pulse => true,
        }
    }
}

/// Limit switch override of a control frame. While `enabled`, it replaces the stored enable states of the
/// switches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitOverride {
    /// The override is in force.
    pub enabled: bool,
    /// Switches that do not limit.
    pub disabled: Directions,
}

impl LimitOverride {
    /// No override.
    pub const NONE: Self = Self {
        enabled: false,
        disabled: Directions::NONE,
    };
}

/// The sensor of closed loops and soft limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SensorSelect {
    /// Quadrature encoder, four counts per cycle.
    #[default]
    Quadrature,
    /// Analog input, 0 to 1023.
    AnalogPotentiometer,
    /// Analog input that goes on counting past either end.
    AnalogEncoder,
    /// Rising edges of channel A.
    RisingEdges,
    /// No sensor: position and velocity are 0.
    None,
}

/// Options that hold as long as the command that carries them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveOpts {
    /// Gain set for the closed loops.
    pub slot: Slot,
    /// Neutral behaviour instead of the stored one.
    pub neutral: Option<Neutral>,
    /// Limit switch override.
    pub limits: LimitOverride,
    /// The sensor of closed loops and soft limits; the encoder unless the policy follows
    /// [all](super::policy::SensorSet::All).
    pub sensor: SensorSelect,
    /// Count the selected sensor the other way round (with [`SensorSet::Encoder`] ignored while
    /// following).
    ///
    /// [`SensorSet::Encoder`]: super::policy::SensorSet::Encoder
    pub reverse_sensor: bool,
    /// Drive the terminals the other way round.
    pub reverse_motor: bool,
    /// Largest change of the duty cycle, 0 = at once: with [`Law::PerTick`] throttle units (±32767) per
    /// 500 µs tick outside the closed loops, with [`Law::Throttle`] throttle units (±1023) per 10 ms in
    /// every mode.
    ///
    /// [`Law::PerTick`]: super::policy::Law::PerTick
    /// [`Law::Throttle`]: super::policy::Law::Throttle
    pub ramp: u16,
}

impl DriveOpts {
    /// No option: what is stored counts, the encoder is the sensor, nothing is reversed or ramped.
    pub const NONE: Self = Self {
        slot: Slot::Zero,
        neutral: None,
        limits: LimitOverride::NONE,
        sensor: SensorSelect::Quadrature,
        reverse_sensor: false,
        reverse_motor: false,
        ramp: 0,
    };
}

/// Last report of the controller that is being followed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MasterReport {
    /// Duty cycle applied by the master.
    pub duty: Duty,
    /// Changes with every report; restarts the follower's timeout.
    pub sequence: u32,
}

/// Whose position is overwritten.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PositionOf {
    /// The selected sensor's, by its own rule, as seen after sensor reversal.
    #[default]
    Selected,
    /// The quadrature encoder's, as it counts.
    Encoder,
}

/// An order to overwrite a position. Acts once for every new `generation`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetPosition {
    /// Whose position.
    pub of: PositionOf,
    /// New position in counts.
    pub counts: i32,
    /// Changes with every order.
    pub generation: u32,
}

/// An order to overwrite the sum of errors of the closed loop of [`Law::Throttle`]. Acts once for every
/// new `generation`.
///
/// [`Law::Throttle`]: super::policy::Law::Throttle
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetAccumulator {
    /// New sum.
    pub value: i32,
    /// Changes with every order.
    pub generation: u32,
}

/// Permission to drive, where it is [separate](super::policy::Enabling::Separate) from the command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Enable {
    /// Changes with every permission; restarts its timeout.
    pub sequence: u32,
    /// The permission has been withdrawn.
    pub withdrawn: bool,
}

/// Everything the engine is told, whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// Changes whenever anything else in the command does: the tick looks at most of a command only then.
    pub revision: u32,
    /// Changes with every control frame; restarts the heartbeat.
    pub sequence: u32,
    /// What to drive.
    pub setpoint: Setpoint,
    /// How to drive it.
    pub opts: DriveOpts,
    /// What the followed controller does.
    pub master: MasterReport,
    /// Pending order to overwrite the position.
    pub set_position: SetPosition,
    /// Pending order to overwrite the sum of errors.
    pub set_accumulator: SetAccumulator,
    /// Permission to drive, where the policy asks for it.
    pub enable: Enable,
    /// Changes with every event that makes the drive pause for the policy's time.
    pub pause: u32,
}
