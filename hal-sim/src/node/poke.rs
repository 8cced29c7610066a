//! Interference with a node.

use windlass_core::engine::snapshot::Pulse;

use super::{BOOT_TICKS, Power, SimNode};
use crate::truth::Poke;

impl SimNode {
    /// Interferes with the node.
    pub fn poke(&mut self, poke: Poke) {
        if !poke.is_sound() {
            return;
        }
        match poke {
            Poke::ForwardLimitClosed(closed) => self.header.forward_closed = closed,
            Poke::ReverseLimitClosed(closed) => self.header.reverse_closed = closed,
            Poke::IndexPin(level) => {
                self.plant.encoder.force_index(level);
                self.header.index_held = self.plant.encoder.forced_index().is_some();
            }
            Poke::AnalogVolts(volts) => {
                self.plant.force_analog(volts);
                self.header.analog_held = self.plant.forced_analog().is_some();
            }
            Poke::BatteryVolts(volts) => self.plant.force_battery(volts),
            Poke::TemperatureCelsius(celsius) => self.plant.force_temperature(celsius),
            Poke::LoadNewtonMetres(torque) => self.plant.set_load(torque),
            Poke::Stall(locked) => self.plant.set_stall(locked),
            Poke::EncoderUnplugged(unplugged) => self.plant.encoder.set_unplugged(unplugged),
            Poke::ShortCircuit(short) => self.plant.set_short_circuit(short),
            Poke::GateDriverFault(active) => self.gate_driver_fault = active,
            Poke::BusConnected(connected) => {
                self.wiring.connected = connected;
                self.wiring_changed = true;
            }
            Poke::Powered(powered) => self.set_powered(powered),
            Poke::J1Loopback(plugged) => self.header.loopback = plugged,
            Poke::PulseWidthUs(width) => self.pulse_width = width,
            Poke::Button => {
                if let Power::On(node) = &mut self.power {
                    node.press_button(self.now);
                }
            }
        }
    }

    fn set_powered(&mut self, powered: bool) {
        match (&self.power, powered) {
            (Power::Off, true) => {
                self.power = Power::Booting {
                    ticks: BOOT_TICKS,
                    handover: None,
                };
            }
            (Power::Booting { .. } | Power::On(_), false) => {
                self.halt(Power::Off);
                self.plant.encoder.restart_counter();
                self.pulse = Pulse::default();
            }
            _ => {}
        }
    }
}
