//! The physical world around one controller: battery, bridge, motor, load, sensors.

mod battery;
mod encoder;
mod front_end;
mod motor;
mod thermal;

use windlass_core::engine::snapshot::{Actuation, IndexCapture};

pub use battery::Battery;
pub use encoder::COUNTS_PER_REVOLUTION;
pub use front_end::FrontEnd;
pub use motor::{DataSheet, Motor};
pub use thermal::Bridge;

use crate::random::Random;
use battery::BatteryState;
use encoder::Encoder;
use front_end::Converter;
use motor::{Load, MotorState, MotorStep, Terminals};
use thermal::Thermal;

/// Control tick in s.
const TICK: f64 = 500e-6;
/// Steps of integration per tick: 250 µs resolve the electrical time constant of 0.64 ms.
const STEPS: u32 = 2;
const COUNTS_PER_RADIAN: f64 = COUNTS_PER_REVOLUTION / core::f64::consts::TAU;

/// Full reverse is −32768 throttle units.
const PER_DUTY_UNIT: f64 = 1.0 / 32768.0;

/// The potentiometer on the motor shaft that drives AIN1: middle of its travel at the start, ten turns
/// from end to end (a common multi-turn part), 3.3 V across it.
const POTENTIOMETER_MIDDLE: f64 = 1.65;
const POTENTIOMETER_VOLTS_PER_COUNT: f64 = 3.3 / (10.0 * COUNTS_PER_REVOLUTION);
const POTENTIOMETER_TOP: f64 = 3.3;

/// Every physical parameter of a node, in SI units. The defaults and their sources stand at each part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlantConfig {
    /// Motor, shaft and flywheel.
    pub motor: Motor,
    /// Supply.
    pub battery: Battery,
    /// Power stage.
    pub bridge: Bridge,
    /// Analog inputs.
    pub front_end: FrontEnd,
}

/// Raw conversions of the four analog inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Conversions {
    pub(crate) current: u16,
    pub(crate) bus_voltage: u16,
    pub(crate) temperature: u16,
    pub(crate) analog_in: u16,
}

/// The physical world around one controller.
#[derive(Clone, Debug)]
pub(crate) struct Plant {
    bridge: Bridge,
    step: MotorStep,
    motor: MotorState,
    battery: BatteryState,
    thermal: Thermal,
    converter: Converter,
    pub(crate) encoder: Encoder,
    random: Random,
    load: Load,
    /// Position of the shaft in counts.
    position: f64,
    /// Current through the bridge's terminals in A; equals the motor's unless they are shorted.
    terminal_current: f64,
    bus_voltage: f64,
    short_circuit: bool,
    shorted_while_driving: bool,
    forced_analog: Option<f64>,
}

impl Plant {
    pub(crate) fn new(config: &PlantConfig, random: Random) -> Self {
        Self {
            bridge: config.bridge,
            step: MotorStep::new(config.motor, TICK / f64::from(STEPS)),
            motor: MotorState::default(),
            battery: BatteryState::new(config.battery),
            thermal: Thermal::new(&config.bridge, TICK),
            converter: Converter::new(&config.front_end),
            encoder: Encoder::new(),
            random,
            load: Load::default(),
            position: 0.0,
            terminal_current: 0.0,
            bus_voltage: config.battery.voltage_full,
            short_circuit: false,
            shorted_while_driving: false,
            forced_analog: None,
        }
    }

    /// Lets one control tick pass while the bridge does this.
    pub(crate) fn advance(&mut self, actuation: Actuation) {
        let driving = match actuation {
            Actuation::Drive(duty) => Some(f64::from(duty.units()) * PER_DUTY_UNIT),
            Actuation::Off | Actuation::Brake => None,
        };
        self.shorted_while_driving = self.short_circuit && driving.is_some();
        let mut travel = 0.0;
        let terminals = self.terminals(actuation, driving);
        for _ in 0..STEPS {
            self.step.advance(&mut self.motor, terminals, self.load);
            travel += self.motor.travel;
        }
        self.position += travel * COUNTS_PER_RADIAN;
        self.encoder.turn_to(self.position);
        self.settle_supply(driving);
    }

    /// What the motor sees at its terminals.
    fn terminals(&self, actuation: Actuation, driving: Option<f64>) -> Terminals {
        if self.short_circuit {
            return Terminals::Source {
                voltage: 0.0,
                resistance: self.bridge.short_resistance,
            };
        }
        match (driving, actuation) {
            // The bridge is averaged over a PWM period: like a transformer it takes the duty's share
            // of the current from the supply, so that the supply's resistance counts with its square.
            (Some(duty), _) => Terminals::Source {
                voltage: duty * self.battery.open_circuit(),
                resistance: self.bridge.resistance + duty * duty * self.battery.resistance(),
            },
            (None, Actuation::Brake) => Terminals::Source {
                voltage: 0.0,
                resistance: self.bridge.resistance,
            },
            (None, _) => Terminals::Floating {
                // A battery that has just been cut may leave less than nothing for an instant.
                against: (self.bus_voltage + self.bridge.diode_voltage).max(0.0),
            },
        }
    }

    /// Supply current, bus voltage and heat at the end of a tick.
    fn settle_supply(&mut self, driving: Option<f64>) {
        let open_circuit = self.battery.open_circuit();
        self.terminal_current = match driving {
            Some(duty) if self.short_circuit => {
                let path = self.bridge.resistance + self.bridge.short_resistance;
                duty * open_circuit / (path + duty * duty * self.battery.resistance())
            }
            _ if self.short_circuit => 0.0,
            _ => self.motor.current,
        };
        let supply = driving.map_or(0.0, |duty| duty * self.terminal_current);
        self.bus_voltage = open_circuit - self.battery.resistance() * supply;
        self.battery.draw(supply, TICK);
        let current = self.terminal_current.abs();
        let switching = match driving {
            Some(_) => self.bridge.switching_share * self.bus_voltage * current,
            None => 0.0,
        };
        self.thermal
            .advance(current * current * self.bridge.resistance + switching);
    }

    /// The analog inputs now; every call draws new noise.
    pub(crate) fn convert(&mut self) -> Conversions {
        Conversions {
            current: self
                .converter
                .current(self.terminal_current, &mut self.random),
            bus_voltage: self.converter.bus_voltage(self.bus_voltage),
            temperature: self.converter.temperature(self.thermal.celsius()),
            analog_in: self.converter.analog_in(self.analog_in()),
        }
    }

    /// Latched rising and falling edges of the index pin.
    pub(crate) fn index_captures(&self) -> (IndexCapture, IndexCapture) {
        self.encoder.captures()
    }

    /// Voltage at AIN1.
    pub(crate) fn analog_in(&self) -> f64 {
        self.forced_analog.unwrap_or_else(|| {
            let turned = self.position * POTENTIOMETER_VOLTS_PER_COUNT;
            (POTENTIOMETER_MIDDLE + turned).clamp(0.0, POTENTIOMETER_TOP)
        })
    }

    /// True while a short circuit makes the gate driver trip.
    pub(crate) fn trips_gate_driver(&self) -> bool {
        self.shorted_while_driving
    }

    /// Current through the terminals in A.
    pub(crate) fn current(&self) -> f64 {
        self.terminal_current
    }

    /// Voltage at the supply terminals of the controller in V.
    pub(crate) fn bus_voltage(&self) -> f64 {
        self.bus_voltage
    }

    /// Case temperature in °C.
    pub(crate) fn temperature(&self) -> f64 {
        self.thermal.celsius()
    }

    /// Position of the shaft in counts.
    pub(crate) fn position(&self) -> f64 {
        self.position
    }

    /// Speed of the shaft in counts per 100 ms.
    pub(crate) fn velocity(&self) -> f64 {
        self.motor.speed * COUNTS_PER_RADIAN * 0.1
    }

    /// Forces the open-circuit voltage of the battery (V, not negative), `None` releases it.
    pub(crate) fn force_battery(&mut self, volts: Option<f64>) {
        self.battery.force(volts.map(|volts| volts.max(0.0)));
        self.bus_voltage = self.battery.open_circuit();
    }

    /// Holds the case at a temperature (°C), `None` lets it relax.
    pub(crate) fn force_temperature(&mut self, celsius: Option<f64>) {
        self.thermal.force(celsius);
    }

    /// Forces the voltage at AIN1 (V), `None` gives it back to the potentiometer.
    pub(crate) fn force_analog(&mut self, volts: Option<f64>) {
        self.forced_analog = volts;
    }

    /// Voltage forced at AIN1.
    pub(crate) fn forced_analog(&self) -> Option<f64> {
        self.forced_analog
    }

    /// Torque of the load against forward rotation in N·m.
    pub(crate) fn set_load(&mut self, torque: f64) {
        self.load.torque = torque;
    }

    /// Locks the shaft.
    pub(crate) fn set_stall(&mut self, locked: bool) {
        self.load.locked = locked;
    }

    /// Connects the motor terminals with each other.
    pub(crate) fn set_short_circuit(&mut self, short: bool) {
        self.short_circuit = short;
        self.shorted_while_driving &= short;
    }
}

#[cfg(test)]
mod tests;
