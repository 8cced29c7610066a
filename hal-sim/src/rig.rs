//! One plant with its switches, without bus or node: what a controller needs around it to run alone.

use windlass_core::engine::snapshot::{Actuation, Pins, Pulse, Sample};
use windlass_core::management::vendor::{PinTest, TestPin};

use crate::pins::Header;
use crate::plant::{Plant, PlantConfig};
use crate::random::Random;

/// One interference with a [`Rig`]. It acts at once and shows in the next sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RigPoke {
    /// Closes the forward limit switch: its pin is low.
    ForwardLimitClosed(bool),
    /// Closes the reverse limit switch: its pin is low.
    ReverseLimitClosed(bool),
    /// Sets the battery's open-circuit voltage; `None` lets it follow the state of charge.
    BatteryVolts(Option<f64>),
    /// Holds the case at this temperature in °C; `None` lets it relax from there.
    TemperatureCelsius(Option<f64>),
    /// Torque on the shaft in N·m, positive against forward rotation.
    LoadNewtonMetres(f64),
    /// Locks the shaft.
    Stall(bool),
    /// Pulls the encoder's cable.
    EncoderUnplugged(bool),
    /// Connects the motor terminals with each other.
    ShortCircuit(bool),
    /// Holds the gate driver's fault output active.
    GateDriverFault(bool),
}

/// The plant of one controller.
#[derive(Clone, Debug)]
pub struct Rig {
    plant: Plant,
    header: Header,
    gate_driver_fault: bool,
}

impl Rig {
    /// A motor at rest on a full battery. The noise of its sensors depends on `seed` only.
    #[must_use]
    pub fn new(config: &PlantConfig, seed: u64) -> Self {
        Self {
            plant: Plant::new(config, Random::new(seed, 0)),
            header: Header::default(),
            gate_driver_fault: false,
        }
    }

    /// Lets one control tick pass while the bridge does this.
    pub fn advance(&mut self, actuation: Actuation) {
        self.plant.advance(actuation);
    }

    /// Everything that the controller measures now; every call draws new noise.
    pub fn sample(&mut self) -> Sample {
        let conversions = self.plant.convert();
        let (encoder_a, encoder_b) = self.plant.encoder.channels();
        let (index_rising, index_falling) = self.plant.index_captures();
        Sample {
            encoder: self.plant.encoder.counter(),
            pins: Pins {
                forward_limit: !self.header.forward_closed,
                reverse_limit: !self.header.reverse_closed,
                encoder_a,
                encoder_b,
                encoder_index: self.plant.encoder.index(),
                gate_driver_fault: self.gate_driver_fault || self.plant.trips_gate_driver(),
            },
            index_rising,
            index_falling,
            current: conversions.current,
            bus_voltage: conversions.bus_voltage,
            temperature: conversions.temperature,
            analog_in: conversions.analog_in,
            pulse: Pulse::default(),
        }
    }

    /// Interferes.
    pub fn poke(&mut self, poke: RigPoke) {
        match poke {
            RigPoke::ForwardLimitClosed(closed) => self.header.forward_closed = closed,
            RigPoke::ReverseLimitClosed(closed) => self.header.reverse_closed = closed,
            RigPoke::BatteryVolts(volts) => self.plant.force_battery(volts),
            RigPoke::TemperatureCelsius(celsius) => self.plant.force_temperature(celsius),
            RigPoke::LoadNewtonMetres(torque) => self.plant.set_load(torque),
            RigPoke::Stall(locked) => self.plant.set_stall(locked),
            RigPoke::EncoderUnplugged(unplugged) => self.plant.encoder.set_unplugged(unplugged),
            RigPoke::ShortCircuit(short) => self.plant.set_short_circuit(short),
            RigPoke::GateDriverFault(active) => self.gate_driver_fault = active,
        }
    }

    /// The pin of the expansion header that fails a test, if one does.
    #[must_use]
    pub fn test_pins(&self, test: PinTest) -> Option<TestPin> {
        self.header.test(test)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use windlass_core::units::Duty;

    #[test]
    fn the_motor_turns_and_the_switches_reach_the_sample() {
        let mut rig = Rig::new(&PlantConfig::default(), 1);
        rig.poke(RigPoke::ForwardLimitClosed(true));
        rig.poke(RigPoke::GateDriverFault(true));
        for _ in 0..200 {
            rig.advance(Actuation::Drive(Duty::new(8000)));
        }
        let sample = rig.sample();
        assert!(sample.encoder > 500, "{}", sample.encoder);
        assert!(sample.current > 2048);
        assert!(!sample.pins.forward_limit && sample.pins.reverse_limit);
        assert!(sample.pins.gate_driver_fault);
    }
}
