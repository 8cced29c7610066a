//! One plant with its switches, without bus or node: what a controller needs around it to run.

use windlass_core::engine::snapshot::{Actuation, Pulse, Sample};
use windlass_core::management::vendor::{PinTest, TestPin};

use crate::pins::Header;
use crate::plant::{Plant, PlantConfig};
use crate::poke::Poke;
use crate::random::Random;
use crate::wires::{self, Level};

/// Ticks between RC-PWM pulses: 20 ms, the frame of a servo signal.
const PULSE_TICKS: u32 = 40;

/// The plant of one controller.
#[derive(Clone, Debug)]
pub struct Rig {
    pub(crate) plant: Plant,
    pub(crate) header: Header,
    driver: wires::Driver,
    inputs: wires::InputPins,
    gate_driver_fault: bool,
    pulse_width: Option<u16>,
    pulse: Pulse,
    pulse_ticks: u32,
}

impl Rig {
    /// A motor at rest on a full battery. The noise of its sensors depends on `seed` only.
    #[must_use]
    pub fn new(config: &PlantConfig, seed: u64) -> Self {
        Self::with_noise(config, Random::new(seed, 0))
    }

    pub(crate) fn with_noise(config: &PlantConfig, noise: Random) -> Self {
        Self {
            plant: Plant::new(config, noise),
            header: Header::default(),
            driver: wires::driver(),
            inputs: wires::inputs(),
            gate_driver_fault: false,
            pulse_width: None,
            pulse: Pulse::default(),
            pulse_ticks: 0,
        }
    }

    /// Lets one control tick pass while the bridge does this.
    pub fn advance(&mut self, actuation: Actuation) {
        // Virtual pins have no errors.
        let _ = self.driver.apply(actuation);
        self.plant.advance(wires::power_stage(&self.driver));
    }

    /// Everything that the controller measures now; every call draws new noise.
    pub fn sample(&mut self) -> Sample {
        if let Some(width_us) = self.pulse_width {
            self.pulse_ticks += 1;
            if self.pulse_ticks >= PULSE_TICKS {
                self.pulse_ticks = 0;
                self.pulse.width_us = width_us;
                self.pulse.count = self.pulse.count.wrapping_add(1);
            }
        }
        let conversions = self.plant.convert();
        let (encoder_a, encoder_b) = self.plant.encoder.channels();
        let fault = self.gate_driver_fault || self.plant.trips_gate_driver();
        self.inputs.forward_limit = Level(!self.header.forward_closed);
        self.inputs.reverse_limit = Level(!self.header.reverse_closed);
        self.inputs.encoder_a = Level(encoder_a);
        self.inputs.encoder_b = Level(encoder_b);
        self.inputs.encoder_index = Level(self.plant.encoder.index());
        self.inputs.gate_driver_fault_n = Level(!fault);
        let (index_rising, index_falling) = self.plant.index_captures();
        Sample {
            encoder: self.plant.encoder.counter(),
            pins: self.inputs.read(),
            index_rising,
            index_falling,
            encoder_a_rises: self.plant.encoder.a_rises(),
            current: conversions.current,
            bus_voltage: conversions.bus_voltage,
            temperature: conversions.temperature,
            analog_in: conversions.analog_in,
            pulse: self.pulse,
        }
    }

    /// Interferes; false if the poke is not for the plant and its switches, or makes no sense.
    pub fn poke(&mut self, poke: Poke) -> bool {
        if !poke.is_sound() {
            return false;
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
            Poke::J1Loopback(plugged) => self.header.loopback = plugged,
            Poke::PulseWidthUs(width) => self.pulse_width = width,
            Poke::BusConnected(_) | Poke::Powered(_) | Poke::Button | Poke::Hang(_) => {
                return false;
            }
        }
        true
    }

    /// The controller has lost its power: its counters start again from zero, the shaft goes on.
    #[cfg(feature = "std")]
    pub(crate) fn restart_counters(&mut self) {
        self.plant.encoder.restart_counter();
        self.pulse = Pulse::default();
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
    use windlass_core::engine::snapshot::Pin;
    use windlass_core::units::Duty;

    #[test]
    fn the_motor_turns_and_the_switches_reach_the_sample() {
        let mut rig = Rig::new(&PlantConfig::default(), 1);
        rig.poke(Poke::ForwardLimitClosed(true));
        rig.poke(Poke::GateDriverFault(true));
        for _ in 0..200 {
            rig.advance(Actuation::Drive(Duty::new(8000)));
        }
        let sample = rig.sample();
        assert!(sample.encoder > 500, "{}", sample.encoder);
        assert!(sample.current > 2048);
        assert!(!sample.pins.is_high(Pin::ForwardLimit) && sample.pins.is_high(Pin::ReverseLimit));
        assert!(sample.pins.is_high(Pin::GateDriverFault));
    }
}
