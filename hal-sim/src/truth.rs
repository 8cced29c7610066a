//! What really happens at a node, and the ways to interfere with it.

use windlass_core::dialect::DialectKind;
use windlass_core::engine::command::Neutral;
use windlass_core::engine::snapshot::DriveState;
use windlass_core::led::Leds;
use windlass_core::management::wire::ImageType;
use windlass_core::node::Counters;

use crate::controller::ErrorState;

/// Plant and pins as they are, not as the node sees them; state as of the node's latest tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Driving dialect.
    pub dialect: DialectKind,
    /// Device number, 0 = none.
    pub number: u8,
    /// Position of the shaft in encoder counts since the world began.
    pub position_counts: i64,
    /// Speed of the shaft in encoder counts per 100 ms.
    pub velocity_counts_per_100ms: f64,
    /// Current through the terminals in A, positive from M+ to M−.
    pub current_a: f64,
    /// Voltage at the controller's supply terminals in V.
    pub bus_v: f64,
    /// Case temperature in °C.
    pub temp_c: f64,
    /// Voltage at AIN1.
    pub analog_v: f64,
    /// Duty cycle at the terminals, −32768 to 32767.
    pub duty: i16,
    /// What the terminals do: shorted (brake) or floating (coast); while driving, what they would do at
    /// zero duty cycle.
    pub neutral: Neutral,
    /// The forward limit switch connects its pin to ground.
    pub fwd_limit_closed: bool,
    /// The reverse limit switch connects its pin to ground.
    pub rev_limit_closed: bool,
    /// Level at the index pin.
    pub index_pin: bool,
    /// LEDs; all dark without power.
    pub leds: Leds,
    /// The image that runs, or ran last.
    pub mode: ImageType,
    /// The controller has power.
    pub powered: bool,
    /// The CAN wires are plugged in.
    pub bus_connected: bool,
    /// State of the drive.
    pub drive_state: DriveState,
    /// Active faults as in `paramActiveFaults`.
    pub faults: u8,
    /// Complete sets written to the settings memory since the world began.
    pub flash_writes: u32,
    /// Pages erased for that: the bench's settings memory is one page that is erased for every set.
    pub flash_erases: u32,
    /// Session id; none while no bus is seen.
    pub session: Option<u16>,
    /// Transmit error counter of the CAN controller.
    pub tec: u16,
    /// Receive error counter of the CAN controller.
    pub rec: u16,
    /// Error state of the CAN controller.
    pub error_state: ErrorState,
    /// Times that the CAN controller went bus-off.
    pub bus_off_count: u32,
    /// Frames counted by the node since it started.
    pub counters: Counters,
}

/// One interference with a node while the world runs. It acts at once; the node sees it at its next tick.
///
/// A number that is not finite changes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Poke {
    /// Closes the forward limit switch: its pin is low.
    ForwardLimitClosed(bool),
    /// Closes the reverse limit switch: its pin is low.
    ReverseLimitClosed(bool),
    /// Holds the index pin at a level; `None` gives it back to the encoder.
    IndexPin(Option<bool>),
    /// Forces AIN1 to a voltage; `None` gives it back to the potentiometer on the shaft.
    AnalogVolts(Option<f64>),
    /// Sets the battery's open-circuit voltage (a negative one counts as 0); `None` lets it follow the
    /// state of charge.
    BatteryVolts(Option<f64>),
    /// Holds the case at this temperature in °C until the next poke; `None` lets it relax from there.
    TemperatureCelsius(Option<f64>),
    /// Torque on the shaft in N·m, positive against forward rotation, whichever way it turns.
    LoadNewtonMetres(f64),
    /// Locks the shaft.
    Stall(bool),
    /// Pulls the encoder's cable: A, B and index read high, the counter stands still.
    EncoderUnplugged(bool),
    /// Connects the motor terminals with each other.
    ShortCircuit(bool),
    /// Holds the gate driver's fault output active.
    GateDriverFault(bool),
    /// Plugs the CAN wires in or out.
    BusConnected(bool),
    /// Switches the controller's power. Its RAM and encoder count are lost, the shaft goes on turning.
    Powered(bool),
    /// Plugs in the loopback fixture of the header's open-circuit test.
    J1Loopback(bool),
    /// Feeds RC-PWM pulses of this width, one every 20 ms; `None` stops them.
    PulseWidthUs(Option<u16>),
    /// Presses the brake/coast button.
    Button,
}

impl Poke {
    /// False if the poke holds a number that is not finite.
    pub(crate) fn is_sound(&self) -> bool {
        match self {
            Self::AnalogVolts(value)
            | Self::BatteryVolts(value)
            | Self::TemperatureCelsius(value) => value.is_none_or(f64::is_finite),
            Self::LoadNewtonMetres(torque) => torque.is_finite(),
            _ => true,
        }
    }
}
