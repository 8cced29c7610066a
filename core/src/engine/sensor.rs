//! From raw samples to measured values: encoder position and velocity, current, voltages, temperature.

use super::command::{Command, PositionOf, SensorSelect, SetPosition, Setpoint};
use super::limit::Directions;
use super::other_sensors::{OtherSensors, Reading};
use super::settings::{IndexSettings, Policy, SensorSet, Settings};
use super::snapshot::{Conversions, RawSensors, Sample, Snapshot};
use crate::units::{Amps, Celsius, Volts};

/// Ticks of the velocity window: 100 ms (guide, "Quadrature Encoder Status Frames").
const WINDOW: usize = 200;

/// Samples averaged for the zero of the current sensor at power-on (32 ms).
const ZERO_SAMPLES: u32 = 64;

/// Conversion of no current on an ideal amplifier (guide, `paramAdcCurrentMultiplier`: biased at 1.65 V
/// of 3.3 V).
const ZERO_NOMINAL: u16 = 2048;

/// A zero further off than this (5 % of full scale) is no zero: current flows or the amplifier is broken.
const ZERO_TOLERANCE: u16 = 205;

/// State of the sensors.
#[derive(Clone, Debug)]
pub struct Sensors {
    encoder: Encoder,
    others: OtherSensors,
    /// Zero of the current sensor, and how it is found.
    zero: u16,
    average: Average,
    set_generation: u32,
    /// An order that has not been carried out yet.
    order: Option<SetPosition>,
    /// The sensor of closed loops and soft limits.
    selected: SensorSelect,
    /// It is reversed.
    reverse: bool,
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
            zero: ZERO_NOMINAL,
            average: Average::NONE,
            set_generation: 0,
            order: None,
            selected: SensorSelect::Quadrature,
            reverse: false,
        }
    }

    /// One sample of the self-check; true once the zero of the current sensor is known. To be called until then; the
    /// current that is shown before is void.
    pub fn find_zero(&mut self, sample: &Sample) -> bool {
        let zero = self.average.take(sample.current);
        self.zero = zero.unwrap_or(self.zero);
        zero.is_some()
    }

    /// A command that has changed. Its order to overwrite a position is carried out with the next sample if it is
    /// a new one.
    pub fn obey(&mut self, policy: &Policy, command: &Command) {
        let order = command.set_position;
        if order.generation != self.set_generation {
            self.set_generation = order.generation;
            self.order = Some(order);
            self.encoder.attentive = true;
        }
        let opts = &command.opts;
        (self.selected, self.reverse) = match policy.sensors {
            SensorSet::Encoder => {
                let following = matches!(command.setpoint, Setpoint::Follow(_));
                (SensorSelect::Quadrature, opts.reverse_sensor && !following)
            }
            SensorSet::All => (opts.sensor, opts.reverse_sensor),
        };
    }

    /// Takes one sample and shows what it means. `switch_hit`: limit switches in their active state.
    #[inline]
    pub fn update(
        &mut self,
        settings: &Settings,
        sample: &Sample,
        switch_hit: Directions,
        shown: &mut Snapshot,
    ) {
        let all = settings.policy.sensors == SensorSet::All;
        if all {
            self.others.update(sample);
        }
        if self.encoder.has_news(sample) {
            self.hear(settings.index, sample);
        }
        if !switch_hit
            .intersection(settings.limits.clears_position)
            .is_empty()
        {
            self.encoder.clear(sample);
        }
        let encoder = self.encoder.update(sample);
        let selected = if all {
            shown.raw = self.raw(encoder, sample);
            match self.selected {
                SensorSelect::Quadrature => encoder,
                other => self.others.reading(other),
            }
        } else {
            encoder
        };
        let selected = selected.reversed_if(self.reverse);
        shown.position = selected.position;
        shown.velocity = selected.velocity;
        let current = i32::from(sample.current) - i32::from(self.zero);
        let current = current.wrapping_mul(settings.current_multiplier);
        shown.current = Amps::from_bits(current);
        let board = &settings.board;
        shown.bus_voltage = Volts::from_bits(board.bus_voltage.convert(sample.bus_voltage));
        shown.temperature = Celsius::from_bits(board.temperature.convert(sample.temperature));
        shown.analog_in = Volts::from_bits(board.analog_in.convert(sample.analog_in));
    }

    /// Every sensor as it counts.
    #[inline]
    fn raw(&self, encoder: Reading, sample: &Sample) -> RawSensors {
        RawSensors {
            encoder,
            analog: self.others.analog_encoder(),
            index_rises: sample.index_rising.edges,
            conversions: Conversions {
                current: sample.current,
                bus_voltage: sample.bus_voltage,
                temperature: sample.temperature,
                analog_in: sample.analog_in,
            },
        }
    }

    /// What seldom happens: the first sample, an index edge, an order to overwrite a position.
    #[inline(never)]
    fn hear(&mut self, index: IndexSettings, sample: &Sample) {
        let order = self.order.take();
        let encoder_order = order.and_then(|order| self.overwrite(order));
        self.encoder.move_origin(index, sample, encoder_order);
    }

    /// Carries out an order to overwrite a position; gives the encoder's new counts if they are meant.
    fn overwrite(&mut self, order: SetPosition) -> Option<i32> {
        if order.of == PositionOf::Encoder {
            return Some(order.counts);
        }
        let counts = turned(order.counts, self.reverse);
        match self.selected {
            SensorSelect::Quadrature => return Some(counts),
            SensorSelect::AnalogEncoder => self.others.set_analog_encoder(counts),
            SensorSelect::RisingEdges => self.others.set_rising_edges(counts),
            // Absolute, or nothing to set (manual 13).
            SensorSelect::AnalogPotentiometer | SensorSelect::None => {}
        }
        None
    }
}

/// Counts of a sensor that counts the other way round.
const fn turned(counts: i32, reverse: bool) -> i32 {
    if reverse {
        counts.wrapping_neg()
    } else {
        counts
    }
}

/// Average of the current sensor's samples while the output is off.
#[derive(Clone, Copy, Debug)]
struct Average {
    sum: u32,
    samples: u32,
}

impl Average {
    const NONE: Self = Self { sum: 0, samples: 0 };

    /// Takes one sample; gives the zero once there are enough of them.
    fn take(&mut self, sample: u16) -> Option<u16> {
        self.sum += u32::from(sample);
        self.samples += 1;
        if self.samples < ZERO_SAMPLES {
            return None;
        }
        let zero = ((self.sum + ZERO_SAMPLES / 2) / ZERO_SAMPLES) as u16;
        // Else it begins anew: the self-check goes on, with the output off, until a zero can be found.
        *self = Self::NONE;
        (zero.abs_diff(ZERO_NOMINAL) <= ZERO_TOLERANCE).then_some(zero)
    }
}

/// Quadrature encoder: position with an origin, velocity as the difference over a sliding window.
///
/// The window holds the raw counter, so that setting or clearing the position does not disturb the
/// velocity. Sensor reversal negates what is reported; it keeps no state, so a repeated or lost control
/// frame can not leave the position half reversed.
#[derive(Clone, Debug)]
struct Encoder {
    /// A sample has been taken.
    started: bool,
    /// The next sample is the first one, or there is an order: [`Encoder::move_origin`] has to look.
    attentive: bool,
    at: u8,
    /// Rising and falling edges seen; both are followed, so that choosing the other one is no edge.
    index_edges: [u16; 2],
    /// Hardware counter of the first sample: positions count from power-on.
    first: u32,
    /// Count (relative to `first`) at which the position is zero.
    origin: u32,
    window: [u32; WINDOW],
}

impl Encoder {
    const fn new() -> Self {
        Self {
            started: false,
            attentive: true,
            at: 0,
            index_edges: [0; 2],
            first: 0,
            origin: 0,
            window: [0; WINDOW],
        }
    }

    /// True if [`Encoder::move_origin`] has to look: also with an index edge.
    #[inline]
    fn has_news(&self, sample: &Sample) -> bool {
        let edges = [sample.index_rising.edges, sample.index_falling.edges];
        self.attentive || edges != self.index_edges
    }

    /// The position is zero now.
    fn clear(&mut self, sample: &Sample) {
        self.origin = sample.encoder.wrapping_sub(self.first);
    }

    /// One tick.
    #[inline]
    fn update(&mut self, sample: &Sample) -> Reading {
        let count = sample.encoder.wrapping_sub(self.first);
        Reading {
            velocity: count.wrapping_sub(self.slide(count)) as i32,
            position: count.wrapping_sub(self.origin) as i32,
        }
    }

    /// Where the position counts from after the first sample, an index edge, an order to overwrite it.
    fn move_origin(&mut self, index: IndexSettings, sample: &Sample, order: Option<i32>) {
        self.attentive = false;
        let (rising, falling) = (sample.index_rising, sample.index_falling);
        let mut seen = self.index_edges;
        self.index_edges = [rising.edges, falling.edges];
        if !self.started {
            self.started = true;
            self.first = sample.encoder;
            seen = self.index_edges;
        }
        let [seen_rising, seen_falling] = seen;
        let (capture, seen) = if index.rising {
            (rising, seen_rising)
        } else {
            (falling, seen_falling)
        };
        if index.clears_position && capture.edges != seen {
            self.origin = capture.count.wrapping_sub(self.first);
        }
        if let Some(counts) = order {
            let count = sample.encoder.wrapping_sub(self.first);
            self.origin = count.wrapping_sub(counts as u32);
        }
    }

    /// Puts `count` into the window and gives the one from 100 ms ago.
    fn slide(&mut self, count: u32) -> u32 {
        let at = usize::from(self.at);
        match self.window.get_mut(at) {
            Some(slot) => {
                self.at += 1;
                core::mem::replace(slot, count)
            }
            None => {
                self.at = 1;
                let [first, ..] = &mut self.window;
                core::mem::replace(first, count)
            }
        }
    }
}
