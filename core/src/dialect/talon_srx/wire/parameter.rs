//! Parameters: their numbers, types and frames.

use super::id;
use crate::frame::Frame;
use crate::frc_id::with_number;

/// How the 32 bits of a value are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Signed integer.
    Integer,
    /// 0 or 1.
    Flag,
    /// Unsigned 10.22 number: raw = trunc(value × 2²²).
    Unsigned10Q22,
    /// Signed 10.22 number.
    Signed10Q22,
}

/// What a host may do with a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read and write, kept over a power cycle.
    Stored,
    /// Read and write, in RAM.
    Volatile,
    /// Read only: a set is answered with the value in force.
    ReadOnly,
}

/// One row of the table of parameters.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Which parameter.
    pub id: Parameter,
    /// Type.
    pub encoding: Encoding,
    /// What a host may do with it.
    pub access: Access,
}

macro_rules! parameters {
    ($( $(#[$doc:meta])* $variant:ident = $code:literal, $encoding:ident, $access:ident; )*) => {
        /// A parameter; the discriminant is its number on the wire (docs/talon-srx.md).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum Parameter { $( $(#[$doc])* $variant = $code, )* }

        /// Every parameter that is answered, in ascending order.
        pub static TABLE: &[Row] = &[ $( Row {
            id: Parameter::$variant, encoding: Encoding::$encoding, access: Access::$access,
        }, )* ];

        impl Parameter {
            /// The parameter of a number; `None` where none is known.
            #[must_use]
            pub fn from_code(code: u8) -> Option<Self> {
                TABLE.iter().map(|row| row.id).find(|id| *id as u8 == code)
            }

            /// How its value is read.
            #[must_use]
            pub const fn encoding(self) -> Encoding {
                match self { $( Self::$variant => Encoding::$encoding, )* }
            }

            /// What a host may do with it.
            #[must_use]
            pub const fn access(self) -> Access {
                match self { $( Self::$variant => Access::$access, )* }
            }
        }
    };
}

parameters! {
    /// Slot 0 P gain, throttle per unit of error.
    Slot0P = 1, Unsigned10Q22, Stored;
    /// Slot 0 I gain, throttle per unit of accumulated error.
    Slot0I = 2, Unsigned10Q22, Stored;
    /// Slot 0 D gain, throttle per unit of change of the error in 1 ms.
    Slot0D = 3, Unsigned10Q22, Stored;
    /// Slot 0 F gain, throttle per unit of the target.
    Slot0F = 4, Signed10Q22, Stored;
    /// Slot 0 I zone in sensor units, 0 = off.
    Slot0IZone = 5, Integer, Stored;
    /// Slot 0 closed-loop ramp, throttle per ms, 0 = off.
    Slot0Ramp = 6, Integer, Stored;
    /// Slot 1 P gain.
    Slot1P = 11, Unsigned10Q22, Stored;
    /// Slot 1 I gain.
    Slot1I = 12, Unsigned10Q22, Stored;
    /// Slot 1 D gain.
    Slot1D = 13, Unsigned10Q22, Stored;
    /// Slot 1 F gain.
    Slot1F = 14, Signed10Q22, Stored;
    /// Slot 1 I zone.
    Slot1IZone = 15, Integer, Stored;
    /// Slot 1 closed-loop ramp.
    Slot1Ramp = 16, Integer, Stored;
    /// Forward soft limit, sensor units.
    ForwardSoftThreshold = 21, Integer, Stored;
    /// Reverse soft limit, sensor units.
    ReverseSoftThreshold = 22, Integer, Stored;
    /// Forward soft limit is enabled.
    ForwardSoftEnable = 23, Flag, Stored;
    /// Reverse soft limit is enabled.
    ReverseSoftEnable = 24, Flag, Stored;
    /// Neutral brakes unless it is overridden (else it coasts).
    OnBootBrake = 31, Flag, Stored;
    /// Forward limit switch is normally closed.
    OnBootForwardNormallyClosed = 32, Flag, Stored;
    /// Reverse limit switch is normally closed.
    OnBootReverseNormallyClosed = 33, Flag, Stored;
    /// Forward limit switch does not limit unless it is overridden.
    OnBootForwardDisable = 34, Flag, Stored;
    /// Reverse limit switch does not limit unless it is overridden.
    OnBootReverseDisable = 35, Flag, Stored;
    /// Over-temperature is present.
    FaultOverTemperature = 41, Flag, ReadOnly;
    /// Under-voltage is present.
    FaultUnderVoltage = 42, Flag, ReadOnly;
    /// Forward limit switch, enabled and tripped.
    FaultForwardLimit = 43, Flag, ReadOnly;
    /// Reverse limit switch.
    FaultReverseLimit = 44, Flag, ReadOnly;
    /// Hardware failure.
    FaultHardware = 45, Flag, ReadOnly;
    /// Forward soft limit, enabled and exceeded.
    FaultForwardSoft = 46, Flag, ReadOnly;
    /// Reverse soft limit.
    FaultReverseSoft = 47, Flag, ReadOnly;
    /// Over-temperature since the last clearing.
    StickyOverTemperature = 48, Flag, ReadOnly;
    /// Under-voltage since the last clearing.
    StickyUnderVoltage = 49, Flag, ReadOnly;
    /// Forward limit switch since the last clearing.
    StickyForwardLimit = 50, Flag, ReadOnly;
    /// Reverse limit switch since the last clearing.
    StickyReverseLimit = 51, Flag, ReadOnly;
    /// Forward soft limit since the last clearing.
    StickyForwardSoft = 52, Flag, ReadOnly;
    /// Reverse soft limit since the last clearing.
    StickyReverseSoft = 53, Flag, ReadOnly;
    /// Applied throttle.
    AppliedThrottle = 61, Integer, ReadOnly;
    /// Closed-loop error.
    ClosedLoopError = 62, Integer, ReadOnly;
    /// Code of the selected sensor.
    FeedbackDeviceSelect = 63, Integer, ReadOnly;
    /// Reversal of the closed-loop output.
    ReverseOutput = 64, Flag, ReadOnly;
    /// Code of the mode.
    ModeSelect = 65, Integer, ReadOnly;
    /// Selected slot.
    ProfileSlotSelect = 66, Flag, ReadOnly;
    /// Voltage ramp, throttle per 10 ms.
    RampThrottle = 67, Integer, ReadOnly;
    /// Reversal of the sensor.
    ReverseSensor = 68, Flag, ReadOnly;
    /// Code of the limit switch override.
    LimitSwitchEnable = 69, Integer, ReadOnly;
    /// The forward pin is connected to ground.
    ForwardClosed = 70, Flag, ReadOnly;
    /// The reverse pin is connected to ground.
    ReverseClosed = 71, Flag, ReadOnly;
    /// Position of the selected sensor; a set moves it by the sensor's own rule (manual 13).
    SensorPosition = 73, Integer, Volatile;
    /// Velocity of the selected sensor.
    SensorVelocity = 74, Integer, ReadOnly;
    /// Current, A.
    Current = 75, Signed10Q22, ReadOnly;
    /// Neutral brakes now.
    BrakeIsEnabled = 76, Flag, ReadOnly;
    /// Quadrature position.
    EncoderPosition = 77, Integer, Volatile;
    /// Quadrature velocity.
    EncoderVelocity = 78, Integer, ReadOnly;
    /// Rising edges of the index pin.
    IndexRiseEvents = 79, Integer, Volatile;
    /// Level of quadrature A.
    QuadratureA = 80, Flag, ReadOnly;
    /// Level of quadrature B.
    QuadratureB = 81, Flag, ReadOnly;
    /// Level of the index pin.
    QuadratureIndex = 82, Flag, ReadOnly;
    /// Analog position with overflows.
    AnalogPosition = 83, Integer, ReadOnly;
    /// Analog velocity.
    AnalogVelocity = 84, Integer, ReadOnly;
    /// Temperature, °C.
    Temperature = 85, Signed10Q22, ReadOnly;
    /// Battery voltage, V.
    Battery = 86, Signed10Q22, ReadOnly;
    /// Restarts since power-on.
    ResetCount = 87, Integer, ReadOnly;
    /// Code of the cause of the last reset (ours; none is published).
    ResetFlags = 88, Integer, ReadOnly;
    /// Firmware version, major byte and minor byte.
    FirmwareVersion = 89, Integer, ReadOnly;
    /// Settings have been changed and not yet been saved (our meaning; none is published).
    SettingsChanged = 90, Flag, ReadOnly;
    /// The quadrature inputs are filtered (our meaning; none is published).
    QuadratureFilter = 91, Flag, ReadOnly;
    /// Integral accumulator of the closed loop; 0 clears it (manual 12.2).
    IntegralAccumulator = 93, Integer, Volatile;
    /// Period of Status_1, ms (later firmware; the same as in Control_2).
    Status1Period = 94, Integer, Volatile;
    /// Period of Status_2, ms (later firmware).
    Status2Period = 95, Integer, Volatile;
    /// Period of Status_3, ms (later firmware).
    Status3Period = 96, Integer, Volatile;
    /// Period of Status_4, ms (later firmware).
    Status4Period = 97, Integer, Volatile;
    /// Period of Status_6, ms, 0 = off (later firmware).
    Status6Period = 98, Integer, Volatile;
    /// Period of Status_7, ms, 0 = off (later firmware).
    Status7Period = 99, Integer, Volatile;
}

impl Parameter {
    /// The number on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// Asks for a parameter (1 byte).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterRequest {
    /// Number of the parameter.
    pub parameter: u8,
}

impl ParameterRequest {
    /// Reads the frame's data; `None` unless it has exactly 1 byte.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [parameter] = *frame.exact::<1>()?;
        Some(Self { parameter })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        Frame::extended(with_number(id::PARAMETER_REQUEST, number), [self.parameter])
    }
}

/// A parameter with its value: both the set of a host and the response of a controller (5 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterValue {
    /// Number of the parameter.
    pub parameter: u8,
    /// Value; its type depends on the parameter, see [`Encoding`].
    pub value: u32,
}

impl ParameterValue {
    fn parse(frame: &Frame) -> Option<Self> {
        let [parameter, v0, v1, v2, v3] = *frame.exact::<5>()?;
        Some(Self {
            parameter,
            value: u32::from_le_bytes([v0, v1, v2, v3]),
        })
    }

    const fn emit(&self, id: u32) -> Frame {
        let [v0, v1, v2, v3] = self.value.to_le_bytes();
        Frame::extended(id, [self.parameter, v0, v1, v2, v3])
    }

    /// Reads the data of a response; `None` unless it has exactly 5 bytes.
    #[must_use]
    pub fn parse_response(frame: &Frame) -> Option<Self> {
        Self::parse(frame)
    }

    /// The response of device `number`.
    #[must_use]
    pub const fn emit_response(&self, number: u8) -> Frame {
        self.emit(with_number(id::PARAMETER_RESPONSE, number))
    }

    /// Reads the data of a set; `None` unless it has exactly 5 bytes.
    #[must_use]
    pub fn parse_set(frame: &Frame) -> Option<Self> {
        Self::parse(frame)
    }

    /// The set for device `number`.
    #[must_use]
    pub const fn emit_set(&self, number: u8) -> Frame {
        self.emit(with_number(id::PARAMETER_SET, number))
    }
}
