//! From raw samples to measured values: encoder position and velocity, current, voltages, temperature.

use super::command::{Command, PositionOf, SensorSelect, Setpoint};
use super::limit::switch_hit;
use super::other_sensors::{OtherSensors, Reading};
use super::settings::{SensorSet, Settings};
use super::snapshot::{Conversions, RawSensors, Sample};

/// Ticks of the velocity window: 100 ms (guide, "Quadrature Encoder Status Frames").
const WINDOW: usize = 200;

/// Samples averaged for the zero of the current sensor at power-on (32 ms).
const ZERO_SAMPLES: u32 = 64;

/// Conversion of no current on an ideal amplifier (guide, `paramAdcCurrentMultiplier`: biased at 1.65 V
/// of 3.3 V).
const ZERO_NOMINAL: u16 = 2048;

/// A zero further off than this (5 % of full scale) is no zero: current flows or the amplifier is broken.
const ZERO_TOLERANCE: u16 = 205;

/// Measured values of one tick; electrical ones in 16.16.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measured {
    /// Counts of the selected sensor, after sensor reversal.
    pub position: i32,
    /// Counts per 100 ms, after sensor reversal.
    pub velocity: i32,
    /// Amperes.
    pub current: i32,
    /// Volts.
    pub bus_voltage: i32,
    /// Degrees Celsius.
    pub temperature: i32,
    /// Volts.
    pub analog_in: i32,
}

/// State of the sensors.
#[derive(Clone, Debug)]
pub struct Sensors {
    encoder: Encoder,
    others: OtherSensors,
    raw: RawSensors,
    zero: ZeroCurrent,
    set_generation: u32,
}

impl Default for Sensors {
    fn default() -> Self {
        Self::new()
    }
}

impl Sensors {
    /// Sensors at power-on: position 0, zero of the current unknown.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            encoder: Encoder::new(),
            others: OtherSensors::new(),
            raw: RawSensors::NONE,
            zero: ZeroCurrent::Averaging { sum: 0, samples: 0 },
            set_generation: 0,
        }
    }

    /// Every sensor as it counts, where all are followed.
    #[must_use]
    pub const fn raw(&self) -> &RawSensors {
        &self.raw
    }

    /// True once the zero of the current sensor is known.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        matches!(self.zero, ZeroCurrent::Known(_))
    }

    /// Takes one sample.
    pub fn update(&mut self, settings: &Settings, sample: &Sample, command: &Command) -> Measured {
        let order = command.set_position;
        let new = order.generation != self.set_generation;
        self.set_generation = order.generation;
        let selected = match settings.policy.sensors {
            SensorSet::Encoder => {
                let following = matches!(command.setpoint, Setpoint::Follow(_));
                let reverse = command.opts.reverse_sensor && !following;
                let counts = new.then_some(order.counts);
                self.encoder.update(settings, sample, counts, reverse)
            }
            SensorSet::All => self.update_all(settings, sample, command, new),
        };
        let current = self
            .zero
            .update(sample.current)
            .wrapping_mul(settings.current_multiplier);
        Measured {
            position: selected.position,
            velocity: selected.velocity,
            current,
            bus_voltage: settings.board.bus_voltage.convert(sample.bus_voltage),
            temperature: settings.board.temperature.convert(sample.temperature),
            analog_in: settings.board.analog_in.convert(sample.analog_in),
        }
    }
}

impl Sensors {
    /// Every sensor, and the selected one's reading. `new`: the order to overwrite a position has not
    /// been carried out yet.
    #[inline(never)]
    fn update_all(
        &mut self,
        settings: &Settings,
        sample: &Sample,
        command: &Command,
        new: bool,
    ) -> Reading {
        let (opts, order) = (&command.opts, command.set_position);
        self.others.update(sample);
        let mut encoder_order = None;
        if new {
            match (order.of, opts.sensor) {
                (PositionOf::Encoder, _) => encoder_order = Some(order.counts),
                (PositionOf::Selected, sensor) => {
                    let counts = if opts.reverse_sensor {
                        order.counts.wrapping_neg()
                    } else {
                        order.counts
                    };
                    match sensor {
                        SensorSelect::Quadrature => encoder_order = Some(counts),
                        SensorSelect::AnalogEncoder => self.others.set_analog_encoder(counts),
                        SensorSelect::RisingEdges => self.others.set_rising_edges(counts),
                        // Absolute, or nothing to set (manual 13).
                        SensorSelect::AnalogPotentiometer | SensorSelect::None => {}
                    }
                }
            }
        }
        let encoder = self.encoder.update(settings, sample, encoder_order, false);
        let analog = self.others.analog_encoder();
        let selected = match opts.sensor {
            SensorSelect::Quadrature => encoder,
            SensorSelect::AnalogPotentiometer => self.others.potentiometer(),
            SensorSelect::AnalogEncoder => analog,
            SensorSelect::RisingEdges => self.others.rising_edges(),
            SensorSelect::None => Reading::default(),
        };
        self.raw = RawSensors {
            encoder,
            analog,
            index_rises: sample.index_rising.edges,
            conversions: Conversions {
                current: sample.current,
                bus_voltage: sample.bus_voltage,
                temperature: sample.temperature,
                analog_in: sample.analog_in,
            },
        };
        selected.reversed_if(opts.reverse_sensor)
    }
}

/// Zero of the current sensor.
#[derive(Clone, Copy, Debug)]
enum ZeroCurrent {
    /// Averaging samples while the output is off.
    Averaging { sum: u32, samples: u32 },
    /// Found.
    Known(u16),
}

impl ZeroCurrent {
    /// Conversion steps above zero; 0 while the zero is unknown.
    fn update(&mut self, sample: u16) -> i32 {
        match *self {
            Self::Known(zero) => i32::from(sample & 0x0FFF) - i32::from(zero),
            Self::Averaging { sum, samples } => {
                let (sum, samples) = (sum + u32::from(sample & 0x0FFF), samples + 1);
                *self = Self::Averaging { sum, samples };
                if samples == ZERO_SAMPLES {
                    let zero = ((sum + ZERO_SAMPLES / 2) / ZERO_SAMPLES) as u16;
                    *self = if zero.abs_diff(ZERO_NOMINAL) <= ZERO_TOLERANCE {
                        Self::Known(zero)
                    } else {
                        // Stay in the self-check, with the output off, until a zero can be found.
                        Self::Averaging { sum: 0, samples: 0 }
                    };
                }
                0
            }
        }
    }
}

/// Quadrature encoder: position with an origin, velocity as the difference over a sliding window.
///
/// The window holds the raw counter, so that setting or clearing the position does not disturb the
/// velocity. Sensor reversal negates what is reported; it keeps no state, so a repeated or lost control
/// frame can not leave the position half reversed.
#[derive(Clone, Debug)]
struct Encoder {
    /// Hardware counter of the first sample: positions count from power-on.
    first: Option<u32>,
    /// Count (relative to `first`) at which the position is zero.
    origin: u32,
    window: [u32; WINDOW],
    at: u8,
    /// Rising and falling edges seen; both are followed, so that choosing the other one is no edge.
    index_edges: [u16; 2],
}

impl Encoder {
    const fn new() -> Self {
        Self {
            first: None,
            origin: 0,
            window: [0; WINDOW],
            at: 0,
            index_edges: [0; 2],
        }
    }

    fn update(
        &mut self,
        settings: &Settings,
        sample: &Sample,
        order: Option<i32>,
        reverse: bool,
    ) -> Reading {
        let first = match self.first {
            Some(first) => first,
            None => {
                self.index_edges = [sample.index_rising.edges, sample.index_falling.edges];
                *self.first.insert(sample.encoder)
            }
        };
        let count = sample.encoder.wrapping_sub(first);
        let [rising, falling] = self.index_edges;
        self.index_edges = [sample.index_rising.edges, sample.index_falling.edges];
        let (index, seen) = if settings.index.rising {
            (sample.index_rising, rising)
        } else {
            (sample.index_falling, falling)
        };
        if settings.index.clears_position && index.edges != seen {
            self.origin = index.count.wrapping_sub(first);
        }
        if let Some(counts) = order {
            let counts = if reverse {
                counts.wrapping_neg()
            } else {
                counts
            };
            self.origin = count.wrapping_sub(counts as u32);
        }
        let forward = &settings.forward;
        let reverse_limit = &settings.reverse;
        if (forward.clears_position && switch_hit(forward, sample.pins.forward_limit))
            || (reverse_limit.clears_position
                && switch_hit(reverse_limit, sample.pins.reverse_limit))
        {
            self.origin = count;
        }
        let velocity = count.wrapping_sub(self.slide(count)) as i32;
        let position = count.wrapping_sub(self.origin) as i32;
        Reading { position, velocity }.reversed_if(reverse)
    }

    /// Puts `count` into the window and gives the one from 100 ms ago.
    fn slide(&mut self, count: u32) -> u32 {
        let at = usize::from(self.at);
        self.at = if at + 1 < WINDOW { self.at + 1 } else { 0 };
        match self.window.get_mut(at) {
            Some(slot) => core::mem::replace(slot, count),
            None => count,
        }
    }
}
