//! Sensors besides the quadrature encoder: the analog input as potentiometer and as continuous encoder,
//! and the counter of rising edges. Sampled once per millisecond.
//!
//! Source: Talon SRX manual, 7, 13, 16.11 and 17.1 to 17.4; decisions of `docs/talon-srx.md`.

use super::snapshot::Sample;

/// Samples of the velocity window: 100 ms.
const WINDOW: usize = 100;

/// Steps of the analog sensor from end to end.
const TURN: i32 = 1024;
const TURN_MASK: i32 = TURN - 1;

/// Samples from 1 ms to the next that differ by more than half the range have passed the end.
const WRAP: i32 = TURN / 2;

/// The last 100 ms of a value.
#[derive(Clone, Debug)]
struct Window<T> {
    values: [T; WINDOW],
    at: u8,
}

impl<T: Copy> Window<T> {
    const fn new(value: T) -> Self {
        Self {
            values: [value; WINDOW],
            at: 0,
        }
    }

    /// Puts `value` in and gives the one from 100 ms ago.
    fn slide(&mut self, value: T) -> T {
        let at = usize::from(self.at);
        self.at = if at + 1 < WINDOW { self.at + 1 } else { 0 };
        match self.values.get_mut(at) {
            Some(slot) => core::mem::replace(slot, value),
            None => value,
        }
    }
}

/// A position with its change over the last 100 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// Position in the sensor's units.
    pub position: i32,
    /// Units per 100 ms.
    pub velocity: i32,
}

impl Reading {
    /// Position and velocity 0.
    pub const ZERO: Self = Self {
        position: 0,
        velocity: 0,
    };

    /// The reading of a sensor that counts the other way round.
    #[must_use]
    pub(super) fn reversed_if(self, reverse: bool) -> Self {
        if reverse {
            Self {
                position: self.position.wrapping_neg(),
                velocity: self.velocity.wrapping_neg(),
            }
        } else {
            self
        }
    }
}

/// State of the sensors besides the quadrature encoder.
#[derive(Clone, Debug)]
pub(super) struct OtherSensors {
    /// The next tick takes a sample: every second one.
    due: bool,
    /// First conversion, and first count of edges: the windows hold the difference from them.
    first: Option<(i32, u16)>,
    /// Conversion without wraps: its low 10 bits are the conversion itself.
    unwrapped: i32,
    /// Multiple of a turn that is added to the position.
    offset: i32,
    analog: Window<i32>,
    analog_velocity: i32,
    potentiometer_velocity: i32,
    rises: u16,
    edges: i32,
    edge_window: Window<u16>,
    edge_velocity: i32,
}

impl OtherSensors {
    /// Sensors before the first sample.
    pub(super) const fn new() -> Self {
        Self {
            due: true,
            first: None,
            unwrapped: 0,
            offset: 0,
            analog: Window::new(0),
            analog_velocity: 0,
            potentiometer_velocity: 0,
            rises: 0,
            edges: 0,
            edge_window: Window::new(0),
            edge_velocity: 0,
        }
    }

    /// To be called every tick; works in every second one.
    pub(super) fn update(&mut self, sample: &Sample) {
        let due = self.due;
        self.due = !due;
        if due {
            self.take(sample);
        }
    }

    fn take(&mut self, sample: &Sample) {
        // The upper 10 bits of the 12-bit conversion.
        let conversion = i32::from(sample.analog_in >> 2) & TURN_MASK;
        let rises = sample.encoder_a_rises;
        let (first, first_rises) = match self.first {
            Some(first) => first,
            None => {
                self.unwrapped = conversion;
                self.rises = rises;
                *self.first.insert((conversion, rises))
            }
        };
        let change = conversion - (self.unwrapped & TURN_MASK);
        let turns = if change > WRAP {
            -TURN
        } else if change < -WRAP {
            TURN
        } else {
            0
        };
        self.unwrapped = self.unwrapped.wrapping_add(change + turns);
        let before = self.analog.slide(self.unwrapped.wrapping_sub(first));
        let before = before.wrapping_add(first);
        self.analog_velocity = self.unwrapped.wrapping_sub(before);
        self.potentiometer_velocity = conversion - (before & TURN_MASK);

        let new = i32::from(rises.wrapping_sub(self.rises));
        self.rises = rises;
        self.edges = self.edges.saturating_add(new);
        let counted = rises.wrapping_sub(first_rises);
        self.edge_velocity = i32::from(counted.wrapping_sub(self.edge_window.slide(counted)));
    }

    /// The analog input as a potentiometer: 0 to 1023.
    pub(super) const fn potentiometer(&self) -> Reading {
        Reading {
            position: self.unwrapped & TURN_MASK,
            velocity: self.potentiometer_velocity,
        }
    }

    /// The analog input as an encoder that goes on past either end.
    pub(super) const fn analog_encoder(&self) -> Reading {
        Reading {
            position: self.unwrapped.wrapping_add(self.offset),
            velocity: self.analog_velocity,
        }
    }

    /// The counter of rising edges.
    pub(super) const fn rising_edges(&self) -> Reading {
        Reading {
            position: self.edges,
            velocity: self.edge_velocity,
        }
    }

    /// Sets the turns of the analog encoder: the low 10 bits stay the conversion (manual 13).
    pub(super) fn set_analog_encoder(&mut self, position: i32) {
        self.offset = (position & !TURN_MASK).wrapping_sub(self.unwrapped & !TURN_MASK);
    }

    /// Sets the counter of rising edges.
    pub(super) fn set_rising_edges(&mut self, position: i32) {
        self.edges = position;
    }
}
