//! What really happens at a node, and the ways to interfere with it.

use windlass_core::dialect::DialectKind;
use windlass_core::engine::command::Neutral;
use windlass_core::engine::snapshot::DriveState;
use windlass_core::led::Leds;
use windlass_core::management::wire::ImageType;
use windlass_core::node::Counters;
use windlass_core::params::SettingsState;

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
    /// Units of the settings memory erased since the world began.
    pub flash_erases: u32,
    /// What is known of the stored settings; none while nothing runs.
    pub settings: Option<SettingsState>,
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
