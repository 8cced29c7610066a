//! Control and status frames of the DMC60C, both ways: the controller parses what the host tool emits
//! and the other way round. Enumeration, vendor commands and parameters are the management channel's,
//! [`crate::management::wire`].
//!
//! Source: DMC60C CAN Protocol Guide, "Message Identifiers and Data Structures" of each section; byte
//! and bit order by `docs/dmc60c.md`, since the guide's tables contradict each other. Every parser has
//! one length gate and gives `None` for anything else; reserved bits are ignored when parsed and zero
//! when emitted. `identifier` arguments are complete identifiers including the device number.

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
    /// `fDisableFwdLimit`.
    pub disable_forward_limit: bool,
    /// `fDisableRevLimit`.
    pub disable_reverse_limit: bool,
    /// `fEnableLimitOverride`.
    pub override_limits: bool,
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
            disable_forward_limit: false,
            disable_reverse_limit: false,
            override_limits: false,
            target: 0,
            ramp: 0,
        }
    }
}

impl Control0 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [fs0, fs1, _, high, low, middle, ramp_low, ramp_high] = *frame.exact::<8>()?;
        Some(Self {
            mode: ModeSelect::from_code(fs0),
            override_neutral: bit(fs0, 4),
            brake: bit(fs0, 5),
            slot_1: bit(fs0, 6),
            reverse_sensor: bit(fs0, 7),
            reverse_motor: bit(fs1, 0),
            disable_forward_limit: bit(fs1, 1),
            disable_reverse_limit: bit(fs1, 2),
            override_limits: bit(fs1, 3),
            target: i24(high, middle, low),
            ramp: u16::from_le_bytes([ramp_low, ramp_high]),
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
            | flag(self.disable_forward_limit, 1)
            | flag(self.disable_reverse_limit, 2)
            | flag(self.override_limits, 3);
        let [low, middle, high, _] = self.target.to_le_bytes();
        let [ramp_low, ramp_high] = self.ramp.to_le_bytes();
        Frame::extended(
            with_number(id::CONTROL_0, number),
            [fs0, fs1, 0, high, low, middle, ramp_low, ramp_high],
        )
    }
}

/// The four flags that `STSGENERAL` has for each limit switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SwitchFlags {
    /// The pin reads high.
    pub pin: bool,
    /// The switch is in its active state.
    pub hit: bool,
    /// The switch is disabled by its parameter.
    pub disabled: bool,
    /// The switch is normally closed.
    pub normally_closed: bool,
}

impl SwitchFlags {
    const fn parse(nibble: u8) -> Self {
        Self {
            pin: bit(nibble, 0),
            hit: bit(nibble, 1),
            disabled: bit(nibble, 2),
            normally_closed: bit(nibble, 3),
        }
    }

    const fn emit(self) -> u8 {
        flag(self.pin, 0)
            | flag(self.hit, 1)
            | flag(self.disabled, 2)
            | flag(self.normally_closed, 3)
    }
}

/// `STSGENERAL`, the general status frame (8 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusGeneral {
    /// `dtcApplied` in throttle units.
    pub duty: i16,
    /// Forward limit switch.
    pub forward: SwitchFlags,
    /// Reverse limit switch.
    pub reverse: SwitchFlags,
    /// Limit override in force.
    pub limit_override: bool,
    /// Forward switch disabled by the control frame.
    pub forward_disable_override: bool,
    /// Reverse switch disabled by the control frame.
    pub reverse_disable_override: bool,
    /// Forward soft limit reached.
    pub soft_forward_hit: bool,
    /// Forward soft limit enabled.
    pub soft_forward_enabled: bool,
    /// Reverse soft limit reached.
    pub soft_reverse_hit: bool,
    /// Reverse soft limit enabled.
    pub soft_reverse_enabled: bool,
    /// Current limiting in force.
    pub current_limited: bool,
    /// Over-temperature fault active.
    pub over_temperature: bool,
    /// Under-voltage fault active.
    pub under_voltage: bool,
    /// Gate driver fault active.
    pub gate_driver: bool,
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
            forward: SwitchFlags::parse(fs0),
            reverse: SwitchFlags::parse(fs0 >> 4),
            limit_override: bit(fs1, 0),
            forward_disable_override: bit(fs1, 1),
            reverse_disable_override: bit(fs1, 2),
            soft_forward_hit: bit(fs1, 3),
            soft_forward_enabled: bit(fs1, 4),
            soft_reverse_hit: bit(fs1, 5),
            soft_reverse_enabled: bit(fs1, 6),
            current_limited: bit(fs1, 7),
            over_temperature: bit(fs2, 0),
            under_voltage: bit(fs2, 1),
            gate_driver: bit(fs2, 2),
            mode: ModeSelect::from_code(fs2 >> 3),
            error_divided: bit(fs2, 7),
            error: i24(high, middle, low),
        })
    }

    /// The frame of device `number`. The error must fit 24 bits.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [duty_low, duty_high] = self.duty.to_le_bytes();
        let fs0 = self.forward.emit() | self.reverse.emit() << 4;
        let fs1 = flag(self.limit_override, 0)
            | flag(self.forward_disable_override, 1)
            | flag(self.reverse_disable_override, 2)
            | flag(self.soft_forward_hit, 3)
            | flag(self.soft_forward_enabled, 4)
            | flag(self.soft_reverse_hit, 5)
            | flag(self.soft_reverse_enabled, 6)
            | flag(self.current_limited, 7);
        let fs2 = flag(self.over_temperature, 0)
            | flag(self.under_voltage, 1)
            | flag(self.gate_driver, 2)
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
