//! Frames of the Talon SRX, both ways: the controller parses what a host emits and the other way round.
//!
//! Source: layouts and conversions of `docs/talon-srx.md`, which names the evidence for each. All frames
//! have 29-bit identifiers; signals of control and status frames have their high byte first, parameter
//! values their low byte first. Every parser has one length gate and gives `None` for anything else;
//! reserved bits are ignored when parsed and zero when emitted. Values that do not fit their field
//! saturate when emitted. `number` arguments are device numbers 0 to 62.

mod control;
mod parameter;
mod status;
#[cfg(test)]
mod tests;

pub use control::{Control1, Control2, Control3, Control5, General, GlobalEnable, RawGeneral};
pub use parameter::{Access, Encoding, Parameter, ParameterRequest, ParameterValue, Row, TABLE};
pub use status::{
    LiveFaults, Status1, Status2, Status3, Status4, Status5, Status6, Status7, Sticky,
};

use crate::field::saturate;
use crate::units::{Amps, Celsius, Volts};

/// Base identifiers, to be completed with a device number.
pub mod id {
    /// General control frame; 8 bytes, or 2 for the enable alone.
    pub const CONTROL_1: u32 = 0x0204_0000;
    /// Periods of the status frames.
    pub const CONTROL_2: u32 = 0x0204_0040;
    /// Clears flags.
    pub const CONTROL_3: u32 = 0x0204_0080;
    /// General control frame that does not enable.
    pub const CONTROL_5: u32 = 0x0204_0100;
    /// General status.
    pub const STATUS_1: u32 = 0x0204_1400;
    /// Feedback status.
    pub const STATUS_2: u32 = 0x0204_1440;
    /// Quadrature encoder status.
    pub const STATUS_3: u32 = 0x0204_1480;
    /// Analog input, temperature, battery voltage.
    pub const STATUS_4: u32 = 0x0204_14C0;
    /// Start-up.
    pub const STATUS_5: u32 = 0x0204_1500;
    /// Raw conversions.
    pub const STATUS_6: u32 = 0x0204_1540;
    /// Counters of tokens.
    pub const STATUS_7: u32 = 0x0204_1580;
    /// Parameter request.
    pub const PARAMETER_REQUEST: u32 = 0x0204_1800;
    /// Parameter response.
    pub const PARAMETER_RESPONSE: u32 = 0x0204_1840;
    /// Parameter set.
    pub const PARAMETER_SET: u32 = 0x0204_1880;
    /// Enables or disables every controller; complete, without a device number.
    pub const GLOBAL_ENABLE: u32 = 0x0004_01BF;
    /// Disables every device of the bus at once, whatever its data; complete.
    pub const DISABLE_ALL: u32 = 0x0000_0000;
}

/// Highest device number (manual 2.1).
pub const MAX_DEVICE_NUMBER: u8 = 62;
/// The number that addresses every device (manual 2.1).
pub const BROADCAST_NUMBER: u8 = 63;

/// Control mode, 4 bits. Firmware 1.1 drives in the modes 0, 1, 2 and 5 (manual 21.1, 21.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ModeSelect {
    /// 0: duty cycle; the demand is a throttle.
    Duty,
    /// 1: closed loop on the position of the selected sensor.
    Position,
    /// 2: closed loop on its velocity.
    Velocity,
    /// 3: closed loop on the current; not in firmware 1.1.
    Current,
    /// 4: voltage compensation; not in firmware 1.1.
    VoltageCompensation,
    /// 5: follower; the demand is the number of the controller that is followed.
    Follower,
    /// 15: no drive.
    #[default]
    NoDrive,
    /// A code of later firmware or without a meaning, kept as it came.
    Reserved(u8),
}

impl ModeSelect {
    /// The mode of a 4-bit code.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code & 0x0F {
            0 => Self::Duty,
            1 => Self::Position,
            2 => Self::Velocity,
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
            Self::Duty => 0,
            Self::Position => 1,
            Self::Velocity => 2,
            Self::Current => 3,
            Self::VoltageCompensation => 4,
            Self::Follower => 5,
            Self::NoDrive => 15,
            Self::Reserved(code) => code & 0x0F,
        }
    }
}

/// The sensor of closed loops and soft limits, 4 bits (manual 7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FeedbackDevice {
    /// 0: quadrature encoder, four counts per cycle.
    #[default]
    Quadrature,
    /// 2: analog potentiometer, 0 to 1023.
    AnalogPotentiometer,
    /// 3: analog encoder, which goes on counting past either end.
    AnalogEncoder,
    /// 4: counter of rising edges of quadrature A.
    RisingEdges,
    /// Any other code: not supported by firmware 1.1 (manual 21.3).
    Unsupported(u8),
}

impl FeedbackDevice {
    /// The sensor of a 4-bit code.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code & 0x0F {
            0 => Self::Quadrature,
            2 => Self::AnalogPotentiometer,
            3 => Self::AnalogEncoder,
            4 => Self::RisingEdges,
            other => Self::Unsupported(other),
        }
    }

    /// The 4-bit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Quadrature => 0,
            Self::AnalogPotentiometer => 2,
            Self::AnalogEncoder => 3,
            Self::RisingEdges => 4,
            Self::Unsupported(code) => code & 0x0F,
        }
    }
}

/// Which limit switches limit, 3 bits: 4 + 2·forward + reverse; without bit 2 the stored settings count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitOverride {
    /// 1 (and 0, 2, 3, kept as they came): the stored settings.
    Stored(u8),
    /// 4 to 7: these switches, whatever is stored.
    Forced {
        /// The forward switch limits.
        forward: bool,
        /// The reverse switch limits.
        reverse: bool,
    },
}

impl LimitOverride {
    /// No override, with the code that clients send.
    pub const STORED: Self = Self::Stored(1);

    /// The override of a 3-bit code.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        let code = code & 7;
        if code & 4 == 0 {
            Self::Stored(code)
        } else {
            Self::Forced {
                forward: code & 2 != 0,
                reverse: code & 1 != 0,
            }
        }
    }

    /// The 3-bit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Stored(code) => code & 3,
            Self::Forced { forward, reverse } => 4 | (forward as u8) << 1 | reverse as u8,
        }
    }
}

impl Default for LimitOverride {
    fn default() -> Self {
        Self::STORED
    }
}

/// What neutral does, 2 bits (manual 4.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BrakeOverride {
    /// 0: the stored setting.
    #[default]
    Stored,
    /// 1: coast.
    Coast,
    /// 2: brake.
    Brake,
    /// 3: without a meaning, taken as the stored setting.
    Reserved,
}

impl BrakeOverride {
    /// The override of a 2-bit code.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code & 3 {
            0 => Self::Stored,
            1 => Self::Coast,
            2 => Self::Brake,
            _ => Self::Reserved,
        }
    }

    /// The 2-bit code.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// Current in steps of 0.125 A as Status_2 carries it: the size, rounded to the nearest, 0 to 1023.
#[must_use]
pub const fn current_raw(current: Amps) -> u16 {
    let steps = (current.to_bits().unsigned_abs() + (1 << 12)) >> 13;
    if steps > 1023 { 1023 } else { steps as u16 }
}

/// The current of a raw value.
#[must_use]
pub const fn current(raw: u16) -> Amps {
    Amps::from_bits(((raw & 0x3FF) as i32) << 13)
}

/// Temperature in steps of 20/31 °C (0.6451612903) above −50 °C as Status_4 carries it: nearest, 0 to 255.
#[must_use]
pub const fn temperature_raw(temperature: Celsius) -> u8 {
    // 165 °C above the lowest one lie beyond the highest step, and times 31 they fit 32 bits.
    let above = above(temperature.to_bits(), -50, 165);
    saturated_u8(rounded_quotient::<{ 20 << 16 }>(above * 31))
}

/// The temperature of a raw value, rounded to the nearest 16.16 number.
#[must_use]
pub const fn temperature(raw: u8) -> Celsius {
    let above = rounded_quotient::<31>((raw as i32 * 20) << 16);
    Celsius::from_bits(above - (50 << 16))
}

/// Battery voltage in steps of 0.05 V above 4 V as Status_4 carries it: nearest, 0 to 255.
#[must_use]
pub const fn battery_raw(voltage: Volts) -> u8 {
    let above = above(voltage.to_bits(), 4, 13);
    saturated_u8(rounded_quotient::<{ 1 << 16 }>(above * 20))
}

/// The battery voltage of a raw value, rounded to the nearest 16.16 number.
#[must_use]
pub const fn battery(raw: u8) -> Volts {
    let above = rounded_quotient::<20>((raw as i32) << 16);
    Volts::from_bits(above + (4 << 16))
}

/// What a 16.16 number exceeds the whole number `from` by, 0 to `span`.
const fn above(bits: i32, from: i32, span: i32) -> i32 {
    saturate(bits.saturating_sub(from << 16), 0, span << 16)
}

/// A 16.16 number as 10.22, saturated: currents, temperatures and voltages that are read as parameters.
#[must_use]
pub const fn to_10_22(bits: i32) -> i32 {
    bits.saturating_mul(1 << 6)
}

const fn saturated_u8(value: i32) -> u8 {
    saturate(value, 0, 255) as u8
}

/// `numerator` / `DENOMINATOR`, neither negative, to the nearest. A constant denominator: dividing by a
/// variable one can panic.
const fn rounded_quotient<const DENOMINATOR: i32>(numerator: i32) -> i32 {
    (numerator + DENOMINATOR / 2) / DENOMINATOR
}

/// Throttle as Status_1 carries it: −1023 to 1023.
const fn saturated_throttle(throttle: i16) -> i16 {
    saturate(throttle as i32, -1023, 1023) as i16
}

/// A 10-bit field of two bytes, high byte (2 bits) first.
const fn u10(high: u8, low: u8) -> u16 {
    ((high & 3) as u16) << 8 | low as u16
}

/// The bytes of a 10-bit field, saturated.
const fn u10_bytes(value: u16) -> [u8; 2] {
    let value = if value > 0x3FF { 0x3FF } else { value };
    value.to_be_bytes()
}
