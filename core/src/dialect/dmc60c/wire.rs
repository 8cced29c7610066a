//! Control and status frames of the DMC60C, both ways: the controller parses what the host tool emits
//! and the other way round. Enumeration, vendor commands and parameters are the management channel's,
//! [`crate::management::wire`].
//!
//! Source: DMC60C CAN Protocol Guide, "Message Identifiers and Data Structures" of each section; byte
//! and bit order by `docs/dmc60c.md`, since the guide's tables contradict each other. Every parser has
//! one length gate and gives `None` for anything else; reserved bits are ignored when parsed and zero
//! when emitted. `identifier` arguments are complete identifiers including the device number.

use crate::engine::command::LimitOverride;
use crate::engine::limit::Directions;
use crate::engine::snapshot::{Fault, Faults};
use crate::field::{bit, flag, i24};
use crate::frame::Frame;
use crate::frc_id::with_number;

/// Base identifiers (guide: message identifier tables of each section).
pub mod id {
    /// General status `msgidStsGeneral`.
    pub const STATUS_GENERAL: u32 = 0x0206_1400;
    /// Quadrature encoder status `msgidStsEncoder`.
    pub const STATUS_ENCODER: u32 = 0x0206_1480;
    /// Analog status `msgidStsAnalog`.
    pub const STATUS_ANALOG: u32 = 0x0206_14C0;
    /// Control frame `msgidControl0`.
    pub const CONTROL_0: u32 = 0x0206_0000;
}

/// Control mode codes of `modeSelect`; 6 to 14 are reserved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModeSelect {
    /// `modeVoltage`, open-loop duty cycle.
    Voltage,
    /// `modeVelocity`.
    Velocity,
    /// `modePosition`.
    Position,
    /// `modeCurrent`.
    Current,
    /// `modeVComp`.
    VoltageCompensation,
    /// `modeFollower`.
    Follower,
    /// `modeNoDrive`.
    NoDrive,
    /// A reserved code, kept for the trace.
    Reserved(u8),
}

impl ModeSelect {
    /// The mode of a 4-bit code.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code & 0x0F {
            0 => Self::Voltage,
            1 => Self::Velocity,
            2 => Self::Position,
            3 => Self::Current,
            4 => Self::VoltageCompensation,
            5 => Self::Follower,
            15 => Self::NoDrive,
            other => Self::Reserved(other),
        }
    }

    /// The 4-bit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Voltage => 0,
            Self::Velocity => 1,
            Self::Position => 2,
            Self::Current => 3,
            Self::VoltageCompensation => 4,
            Self::Follower => 5,
            Self::NoDrive => 15,
            Self::Reserved(code) => code & 0x0F,
        }
    }
}

/// `CANCTRL0`, the control frame (8 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control0 {
    /// `modeSelect`.
    pub mode: ModeSelect,
    /// `fOverrideBC`: `brake` replaces the stored brake/coast setting.
    pub override_neutral: bool,
    /// `fBrakeCoast`: true brakes.
    pub brake: bool,
    /// `pidsltSelect`: true selects slot 1.
    pub slot_1: bool,
    /// `fRevFeedbackSensor`.
    pub reverse_sensor: bool,
    /// `fRevMotor`.
    pub reverse_motor: bool,
    /// `fEnableLimitOverride`, `fDisableFwdLimit` and `fDisableRevLimit`.
    pub limits: LimitOverride,
    /// `trgtH` (byte 3), `trgtM` (byte 5), `trgtL` (byte 4) as a signed 24-bit number.
    pub target: i32,
    /// `vltgRampSet`: throttle units per tick, 0 = at once.
    pub ramp: u16,
}

impl Default for Control0 {
    /// The frame that switches the output off.
    fn default() -> Self {
        Self {
            mode: ModeSelect::NoDrive,
            override_neutral: false,
            brake: false,
            slot_1: false,
            reverse_sensor: false,
            reverse_motor: false,
            limits: LimitOverride::NONE,
            target: 0,
            ramp: 0,
        }
    }
}

impl Control0 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [flags, values] = frame.words()?;
        let [fs0, fs1, ..] = flags.to_le_bytes();
        // The high byte, with the sign, above the two lower ones.
        let target = (flags as i32 >> 24) << 16 | (values & 0xFFFF) as i32;
        Some(Self {
            mode: ModeSelect::from_code(fs0),
            override_neutral: bit(fs0, 4),
            brake: bit(fs0, 5),
            slot_1: bit(fs0, 6),
            reverse_sensor: bit(fs0, 7),
            reverse_motor: bit(fs1, 0),
            limits: LimitOverride {
                enabled: bit(fs1, 3),
                disabled: Directions::from_bits(fs1 >> 1),
            },
            target,
            ramp: (values >> 16) as u16,
        })
    }

    /// The frame for device `number`. A target outside 24 bits loses its high byte.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let fs0 = self.mode.code()
            | flag(self.override_neutral, 4)
            | flag(self.brake, 5)
            | flag(self.slot_1, 6)
            | flag(self.reverse_sensor, 7);
        let fs1 = flag(self.reverse_motor, 0)
            | self.limits.disabled.bits() << 1
            | flag(self.limits.enabled, 3);
        let [low, middle, high, _] = self.target.to_le_bytes();
        let [ramp_low, ramp_high] = self.ramp.to_le_bytes();
        Frame::extended(
            with_number(id::CONTROL_0, number),
            [fs0, fs1, 0, high, low, middle, ramp_low, ramp_high],
        )
    }
}

/// Two flags `distance` bits apart: forward in bit `at`, reverse above it.
const fn spread(set: Directions, at: u8, distance: u8) -> u8 {
    let bits = set.bits();
    ((bits & 1) | (bits >> 1) << distance) << at
}

/// What [`spread`] made.
const fn gathered(byte: u8, at: u8, distance: u8) -> Directions {
    Directions::new(bit(byte, at), bit(byte, at + distance))
}

/// `fOverTemp`, `fUnderVoltage` and `fGateDriver` of `STSGENERAL`: three neighbours of `paramActiveFaults`, in
/// the same order.
const STATUS_FAULTS: u8 = 0x07;
const STATUS_FAULTS_SHIFT: u8 = Fault::OverTemperature as u8;
const _: () = assert!(
    Fault::UnderVoltage as u8 == STATUS_FAULTS_SHIFT + 1
        && Fault::GateDriver as u8 == STATUS_FAULTS_SHIFT + 2
);

/// `STSGENERAL`, the general status frame (8 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusGeneral {
    /// `dtcApplied` in throttle units.
    pub duty: i16,
    /// Limit switch inputs that read high.
    pub limit_pins: Directions,
    /// Limit switches in their active state.
    pub limit_hit: Directions,
    /// Limit switches disabled by their parameter.
    pub limit_disabled: Directions,
    /// Limit switches that are normally closed.
    pub limit_normally_closed: Directions,
    /// Limit override of the control frame.
    pub limit_override: LimitOverride,
    /// Soft limits reached.
    pub soft_hit: Directions,
    /// Soft limits enabled.
    pub soft_enabled: Directions,
    /// Current limiting in force.
    pub current_limited: bool,
    /// Active faults; the frame has over-temperature, under-voltage and gate driver only.
    pub faults: Faults,
    /// `modeSelect`.
    pub mode: ModeSelect,
    /// `fDivErrBy256`: the error was divided by 256.
    pub error_divided: bool,
    /// The closed-loop error field as a signed 24-bit number; its meaning depends on `mode`.
    pub error: i32,
}

impl StatusGeneral {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [duty_low, duty_high, fs0, fs1, fs2, low, middle, high] = *frame.exact::<8>()?;
        Some(Self {
            duty: i16::from_le_bytes([duty_low, duty_high]),
            limit_pins: gathered(fs0, 0, 4),
            limit_hit: gathered(fs0, 1, 4),
            limit_disabled: gathered(fs0, 2, 4),
            limit_normally_closed: gathered(fs0, 3, 4),
            limit_override: LimitOverride {
                enabled: bit(fs1, 0),
                disabled: Directions::from_bits(fs1 >> 1),
            },
            soft_hit: gathered(fs1, 3, 2),
            soft_enabled: gathered(fs1, 4, 2),
            current_limited: bit(fs1, 7),
            faults: Faults::from_bits((fs2 & STATUS_FAULTS) << STATUS_FAULTS_SHIFT),
            mode: ModeSelect::from_code(fs2 >> 3),
            error_divided: bit(fs2, 7),
            error: i24(high, middle, low),
        })
    }

    /// The frame of device `number`. The error must fit 24 bits.
    #[must_use]
    #[inline]
    pub const fn emit(&self, number: u8) -> Frame {
        let [duty_low, duty_high] = self.duty.to_le_bytes();
        let fs0 = spread(self.limit_pins, 0, 4)
            | spread(self.limit_hit, 1, 4)
            | spread(self.limit_disabled, 2, 4)
            | spread(self.limit_normally_closed, 3, 4);
        let fs1 = flag(self.limit_override.enabled, 0)
            | self.limit_override.disabled.bits() << 1
            | spread(self.soft_hit, 3, 2)
            | spread(self.soft_enabled, 4, 2)
            | flag(self.current_limited, 7);
        let fs2 = (self.faults.bits() >> STATUS_FAULTS_SHIFT) & STATUS_FAULTS
            | self.mode.code() << 3
            | flag(self.error_divided, 7);
        let [low, middle, high, _] = self.error.to_le_bytes();
        Frame::extended(
            with_number(id::STATUS_GENERAL, number),
            [duty_low, duty_high, fs0, fs1, fs2, low, middle, high],
        )
    }
}

/// `STSENCODER`, the quadrature encoder status frame (8 bytes; position and velocity high byte first).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusEncoder {
    /// Position field, signed 24 bits.
    pub position: i32,
    /// `fDivPosBy8`: the position was divided by 8.
    pub position_divided: bool,
    /// Velocity field in counts per 100 ms.
    pub velocity: i16,
    /// `fDivVelBy4`: the velocity was divided by 4.
    pub velocity_divided: bool,
    /// QEA reads high.
    pub pin_a: bool,
    /// QEB reads high.
    pub pin_b: bool,
    /// QEIDX reads high.
    pub pin_index: bool,
}

impl StatusEncoder {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [high, middle, low, velocity_high, velocity_low, _, _, flags] = *frame.exact::<8>()?;
        Some(Self {
            position: i24(high, middle, low),
            position_divided: bit(flags, 0),
            velocity: i16::from_be_bytes([velocity_high, velocity_low]),
            velocity_divided: bit(flags, 1),
            pin_a: bit(flags, 2),
            pin_b: bit(flags, 3),
            pin_index: bit(flags, 4),
        })
    }

    /// The frame of device `number`. The position must fit 24 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [low, middle, high, _] = self.position.to_le_bytes();
        let [velocity_high, velocity_low] = self.velocity.to_be_bytes();
        let flags = flag(self.position_divided, 0)
            | flag(self.velocity_divided, 1)
            | flag(self.pin_a, 2)
            | flag(self.pin_b, 3)
            | flag(self.pin_index, 4);
        Frame::extended(
            with_number(id::STATUS_ENCODER, number),
            [high, middle, low, velocity_high, velocity_low, 0, 0, flags],
        )
    }

    /// Position in counts with the divider undone.
    #[must_use]
    pub const fn position_counts(&self) -> i32 {
        if self.position_divided {
            self.position * 8
        } else {
            self.position
        }
    }

    /// Velocity in counts per 100 ms with the divider undone.
    #[must_use]
    pub const fn velocity_counts_per_100ms(&self) -> i32 {
        if self.velocity_divided {
            self.velocity as i32 * 4
        } else {
            self.velocity as i32
        }
    }
}

/// `STSANALOG`, the analog status frame (8 bytes): four signed 8.8 numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusAnalog {
    /// `vltgAnalogIn`, volts at AIN1.
    pub analog_in: i16,
    /// `crntOutput`, amperes.
    pub current: i16,
    /// `tmpAmbient`, degrees Celsius.
    pub temperature: i16,
    /// `vltgVbus`, volts.
    pub bus_voltage: i16,
}

impl StatusAnalog {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [a0, a1, c0, c1, t0, t1, v0, v1] = *frame.exact::<8>()?;
        Some(Self {
            analog_in: i16::from_le_bytes([a0, a1]),
            current: i16::from_le_bytes([c0, c1]),
            temperature: i16::from_le_bytes([t0, t1]),
            bus_voltage: i16::from_le_bytes([v0, v1]),
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [a0, a1] = self.analog_in.to_le_bytes();
        let [c0, c1] = self.current.to_le_bytes();
        let [t0, t1] = self.temperature.to_le_bytes();
        let [v0, v1] = self.bus_voltage.to_le_bytes();
        Frame::extended(
            with_number(id::STATUS_ANALOG, number),
            [a0, a1, c0, c1, t0, t1, v0, v1],
        )
    }
}
