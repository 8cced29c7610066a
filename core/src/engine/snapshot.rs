//! What goes into a tick and what comes out of it.

use super::command::{DriveOpts, Neutral};
use super::limit::Directions;
use super::other_sensors::Reading;
use crate::units::{Amps, Celsius, Duty, Volts};

/// A digital input. The discriminant is its bit position in [`Pins`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pin {
    /// FWDLIM.
    ForwardLimit = 0,
    /// REVLIM.
    ReverseLimit = 1,
    /// QEA.
    EncoderA = 2,
    /// QEB.
    EncoderB = 3,
    /// QEIDX.
    EncoderIndex = 4,
    /// The gate driver reports a fault (already translated to active high).
    GateDriverFault = 5,
}

/// Levels of the digital inputs. Limit and index inputs are pulled up: an open switch reads high, a switch
/// closed to ground reads low.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pins(u8);

impl Pins {
    /// Every input low.
    pub const LOW: Self = Self(0);
    /// Nothing connected: every pull-up reads high, no gate driver fault.
    pub const OPEN: Self = Self(0x1F);

    /// True if the pin reads high.
    #[must_use]
    pub const fn is_high(self, pin: Pin) -> bool {
        self.0 & (1 << pin as u8) != 0
    }

    /// The levels with this pin changed.
    #[must_use]
    pub const fn with(self, pin: Pin, high: bool) -> Self {
        Self(self.0 & !(1 << pin as u8) | (high as u8) << pin as u8)
    }

    /// Changes one level.
    pub const fn set(&mut self, pin: Pin, high: bool) {
        *self = self.with(pin, high);
    }

    /// Directions whose limit input reads high.
    #[must_use]
    pub const fn limits(self) -> Directions {
        Directions::from_bits(self.0)
    }
}

impl Default for Pins {
    /// Nothing connected.
    fn default() -> Self {
        Self::OPEN
    }
}

/// Edges of one direction on the index pin, latched by hardware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexCapture {
    /// Edges seen since power-on, wrapping.
    pub edges: u16,
    /// Encoder counter at the latest edge.
    pub count: u32,
}

/// The RC-PWM input, measured by hardware.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pulse {
    /// Width of the latest pulse in µs.
    pub width_us: u16,
    /// Pulses seen since power-on, wrapping.
    pub count: u16,
}

/// Everything measured for one tick. Analog values are raw 12-bit conversions, 0 to 4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Free-running quadrature counter, four counts per encoder cycle, wrapping.
    pub encoder: u32,
    /// Digital inputs.
    pub pins: Pins,
    /// Rising edges of the index pin.
    pub index_rising: IndexCapture,
    /// Falling edges of the index pin.
    pub index_falling: IndexCapture,
    /// Rising edges of QEA since power-on, wrapping.
    pub encoder_a_rises: u16,
    /// Current-sense amplifier; mid-scale is no current.
    pub current: u16,
    /// Bus voltage divider.
    pub bus_voltage: u16,
    /// Temperature sensor.
    pub temperature: u16,
    /// AIN1.
    pub analog_in: u16,
    /// RC-PWM input.
    pub pulse: Pulse,
}

/// What the bridge does until the next tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Actuation {
    /// Every switch of the bridge open: the terminals float. Also the state at reset and on any fault.
    #[default]
    Off,
    /// Both terminals shorted.
    Brake,
    /// Drive with this duty cycle, which is not zero.
    Drive(Duty),
}

impl Actuation {
    /// The duty cycle at the terminals, zero unless driving.
    #[must_use]
    pub const fn duty(self) -> Duty {
        match self {
            Self::Drive(duty) => duty,
            Self::Off | Self::Brake => Duty::ZERO,
        }
    }
}

/// The control mode that a status frame reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// Open-loop duty cycle.
    Duty,
    /// Closed-loop velocity.
    Velocity,
    /// Closed-loop position.
    Position,
    /// Closed-loop current.
    Current,
    /// Voltage compensation.
    Voltage,
    /// Following another controller.
    Follow,
    /// RC-PWM input.
    Pulse,
    /// Output disabled.
    #[default]
    Off,
}

impl Mode {
    /// True for the modes that use a gain slot.
    #[must_use]
    pub const fn is_closed_loop(self) -> bool {
        matches!(self, Self::Velocity | Self::Position | Self::Current)
    }
}

/// State of the drive, apart from faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DriveState {
    /// Finding the zero of the current sensor after power-on; the output is off.
    #[default]
    SelfCheck,
    /// Waiting for a command; the output is neutral.
    Halted,
    /// Following its command.
    Running,
}

/// A set of faults with the bit positions of DMC60C `paramActiveFaults`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults(u8);

/// One fault. The discriminant is its bit position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault {
    /// Over-current (`fltOverCurrent`).
    OverCurrent = 0,
    /// Over-temperature (`fltOverTemp`).
    OverTemperature = 1,
    /// Under-voltage (`fltUnderVoltage`).
    UnderVoltage = 2,
    /// Gate driver (`fltGateDriver`), most likely a short circuit.
    GateDriver = 3,
    /// Loss of the CAN bus (`fltComm`); recorded, never active.
    Communication = 4,
}

impl Fault {
    /// Every fault in the order of its bit.
    pub const ALL: [Self; 5] = [
        Self::OverCurrent,
        Self::OverTemperature,
        Self::UnderVoltage,
        Self::GateDriver,
        Self::Communication,
    ];

    /// The fault's bit in a fault word.
    #[must_use]
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl Faults {
    /// No fault.
    pub const NONE: Self = Self(0);

    /// Every fault.
    pub const ALL: Self = Self(0x1F);

    /// A set from a fault word; bits without a meaning are dropped.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & Self::ALL.0)
    }

    /// The fault word.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// True if no fault is set.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// True if `fault` is set.
    #[must_use]
    pub const fn contains(self, fault: Fault) -> bool {
        self.0 & fault.bit() != 0
    }

    /// The set with `fault` added.
    #[must_use]
    pub const fn with(self, fault: Fault) -> Self {
        Self(self.0 | fault.bit())
    }

    /// The set with `fault` added if `present`.
    #[must_use]
    pub const fn with_if(self, fault: Fault, present: bool) -> Self {
        Self(self.0 | (present as u8) << fault as u8)
    }

    /// Faults of both sets.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Faults that are in both sets.
    #[must_use]
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Faults of this set that are not in `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The fault with the lowest bit.
    #[must_use]
    pub fn lowest(self) -> Option<Fault> {
        Fault::ALL.into_iter().find(|fault| self.contains(*fault))
    }
}

/// The limits as the engine saw them in this tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitStatus {
    /// Switches in their active state by their type, whether they may limit or not.
    pub switch_hit: Directions,
    /// Switches disabled by parameter or override.
    pub switch_disabled: Directions,
    /// Soft limits that are enabled and reached.
    pub soft_hit: Directions,
    /// Directions that switch or soft limit forbid.
    pub blocked: Directions,
    /// Directions in which a request was just refused.
    pub refused: Directions,
}

impl LimitStatus {
    /// Nothing hit, nothing disabled.
    pub const NONE: Self = Self {
        switch_hit: Directions::NONE,
        switch_disabled: Directions::NONE,
        soft_hit: Directions::NONE,
        blocked: Directions::NONE,
        refused: Directions::NONE,
    };

    /// Switches that are hit and not disabled.
    #[must_use]
    pub const fn tripped(&self) -> Directions {
        self.switch_hit.without(self.switch_disabled)
    }
}

/// Sensors as they count, whichever is selected; all zero unless the policy follows
/// [all](super::policy::SensorSet::All).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawSensors {
    /// Quadrature encoder.
    pub encoder: Reading,
    /// Analog input that goes on counting past either end; its low 10 bits are the conversion.
    pub analog: Reading,
    /// Rising edges of the index pin since power-on, wrapping.
    pub index_rises: u16,
    /// Conversions.
    pub conversions: Conversions,
}

impl RawSensors {
    /// Nothing is followed.
    pub const NONE: Self = Self {
        encoder: Reading::ZERO,
        analog: Reading::ZERO,
        index_rises: 0,
        conversions: Conversions {
            current: 0,
            bus_voltage: 0,
            temperature: 0,
            analog_in: 0,
        },
    };
}

/// Raw 12-bit conversions, 0 to 4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conversions {
    /// Current-sense amplifier.
    pub current: u16,
    /// Bus voltage divider.
    pub bus_voltage: u16,
    /// Temperature sensor.
    pub temperature: u16,
    /// AIN1.
    pub analog_in: u16,
}

/// Everything observable after a tick, in native units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Snapshot {
    /// Mode of the command in force; [`Mode::Off`] once the command has timed out.
    pub mode: Mode,
    /// State of the drive.
    pub state: DriveState,
    /// Active faults; one of the policy's stopping ones means that the output is off.
    pub faults: Faults,
    /// Times that each fault became active since power-on, wrapping, in the order of the bits; the
    /// communication fault is not the engine's and has no place here.
    pub fault_events: [u8; 4],
    /// What the bridge does.
    pub actuation: Actuation,
    /// What the bridge would do at zero duty cycle.
    pub neutral: Neutral,
    /// Options of the command in force.
    pub opts: DriveOpts,
    /// Target minus measured value: throttle units (duty), counts per 100 ms (velocity), counts
    /// (position), 16.16 amperes (current), 16.16 volts (voltage compensation); 0 in other modes.
    pub error: i32,
    /// Position of the selected sensor in its counts, after sensor reversal.
    pub position: i32,
    /// Its velocity in counts per 100 ms, after sensor reversal.
    pub velocity: i32,
    /// Sensors as they count.
    pub raw: RawSensors,
    /// Sum of errors of the closed loop of [`Law::Throttle`](super::policy::Law::Throttle).
    pub accumulator: i32,
    /// Motor current.
    pub current: Amps,
    /// Bus voltage.
    pub bus_voltage: Volts,
    /// Case temperature.
    pub temperature: Celsius,
    /// Voltage at AIN1.
    pub analog_in: Volts,
    /// Digital inputs.
    pub pins: Pins,
    /// Limits of both directions.
    pub limits: LimitStatus,
    /// The current limiter holds the duty cycle down.
    pub current_limited: bool,
    /// The RC-PWM input delivers valid pulses.
    pub pulse_valid: bool,
}

impl Default for Snapshot {
    fn default() -> Self {
        Self::new()
    }
}

impl Snapshot {
    /// A controller at power-on: nothing measured, output off.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            mode: Mode::Off,
            state: DriveState::SelfCheck,
            faults: Faults::NONE,
            fault_events: [0; 4],
            actuation: Actuation::Off,
            neutral: Neutral::Brake,
            opts: DriveOpts::NONE,
            error: 0,
            position: 0,
            velocity: 0,
            raw: RawSensors::NONE,
            accumulator: 0,
            current: Amps::ZERO,
            bus_voltage: Volts::ZERO,
            temperature: Celsius::ZERO,
            analog_in: Volts::ZERO,
            pins: Pins::OPEN,
            limits: LimitStatus::NONE,
            current_limited: false,
            pulse_valid: false,
        }
    }

    /// The duty cycle at the terminals.
    #[must_use]
    pub const fn duty(&self) -> Duty {
        self.actuation.duty()
    }
}
