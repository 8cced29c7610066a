//! Ways to interfere with a controller and its plant.

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
    /// Lets the application hang, also after each restart, until the next poke: its watchdog resets the
    /// controller. The bootloader does not hang.
    Hang(bool),
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
