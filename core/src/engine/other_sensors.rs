//! Sensors besides the quadrature encoder: the analog input as potentiometer and as continuous encoder,
//! and the counter of rising edges. Sampled once per millisecond.
//!
//! Source: Talon SRX manual, 7, 13, 16.11 and 17.1 to 17.4; decisions of `docs/talon-srx.md`.

use super::command::SensorSelect;
use super::snapshot::Sample;

/// Samples of the velocity window: 100 ms.
const WINDOW: usize = 100;

/// Steps of the analog sensor from end to end.
const TURN: i32 = 1024;
const TURN_MASK: i32 = TURN - 1;

/// Samples from 1 ms to the next that differ by more than half the range have passed the end.
const WRAP: i32 = TURN / 2;

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
    /// A sample has been taken.
    started: bool,
    /// Place of the next sample in both windows.
    at: u8,
    /// First conversion.
    first: i32,
    /// What the conversion without wraps has moved since; the low 10 bits of the sum are the conversion itself.
    moved: i32,
    /// Multiple of a turn that is added to the position.
    offset: i32,
    /// The last 100 ms of `moved`.
    moves: [i32; WINDOW],
    analog_velocity: i32,
    potentiometer_velocity: i32,
    rises: u16,
    /// Rises since the first sample, and the last 100 ms of them.
    counted: u16,
    counts: [u16; WINDOW],
    edges: i32,
    edge_velocity: i32,
}

impl OtherSensors {
    /// Sensors before the first sample.
    pub(super) const fn new() -> Self {
        Self {
            due: true,
            started: false,
            at: 0,
            first: 0,
            moved: 0,
            offset: 0,
            moves: [0; WINDOW],
            analog_velocity: 0,
            potentiometer_velocity: 0,
            rises: 0,
            counted: 0,
            counts: [0; WINDOW],
            edges: 0,
            edge_velocity: 0,
        }
    }

    /// To be called every tick; works in every second one.
    #[inline]
    pub(super) fn update(&mut self, sample: &Sample) {
        self.due = !self.due;
        if !self.due {
            self.take(sample);
        }
    }

    #[inline(never)]
    fn take(&mut self, sample: &Sample) {
        // The upper 10 bits of the 12-bit conversion.
        let conversion = i32::from(sample.analog_in >> 2) & TURN_MASK;
        let rises = sample.encoder_a_rises;
        if !self.started {
            self.started = true;
            self.first = conversion;
            self.rises = rises;
        }
        let mut change = conversion - (self.unwrapped() & TURN_MASK);
        if change > WRAP {
            change -= TURN;
        } else if change < -WRAP {
            change += TURN;
        }
        self.moved = self.moved.wrapping_add(change);
        let new = rises.wrapping_sub(self.rises);
        self.rises = rises;
        self.counted = self.counted.wrapping_add(new);
        self.edges = self.edges.saturating_add(i32::from(new));

        let (moved, counted) = self.slide();
        self.analog_velocity = self.moved.wrapping_sub(moved);
        let conversion_before = self.first.wrapping_add(moved) & TURN_MASK;
        self.potentiometer_velocity = conversion - conversion_before;
        self.edge_velocity = i32::from(self.counted.wrapping_sub(counted));
    }

    /// Puts `moved` and `counted` into their windows and gives those from 100 ms ago.
    fn slide(&mut self) -> (i32, u16) {
        let at = usize::from(self.at);
        self.at = if at + 1 < WINDOW { self.at + 1 } else { 0 };
        match (self.moves.get_mut(at), self.counts.get_mut(at)) {
            (Some(moved), Some(counted)) => (
                core::mem::replace(moved, self.moved),
                core::mem::replace(counted, self.counted),
            ),
            // `at` never leaves the windows.
            _ => (0, 0),
        }
    }

    /// The conversion without wraps.
    const fn unwrapped(&self) -> i32 {
        self.first.wrapping_add(self.moved)
    }

    /// What the selected sensor reads; the quadrature encoder is none of these.
    #[inline]
    pub(super) const fn reading(&self, selected: SensorSelect) -> Reading {
        match selected {
            SensorSelect::AnalogPotentiometer => self.potentiometer(),
            SensorSelect::AnalogEncoder => self.analog_encoder(),
            SensorSelect::RisingEdges => self.rising_edges(),
            SensorSelect::Quadrature | SensorSelect::None => Reading::ZERO,
        }
    }

    /// The analog input as a potentiometer: 0 to 1023.
    const fn potentiometer(&self) -> Reading {
        Reading {
            position: self.unwrapped() & TURN_MASK,
            velocity: self.potentiometer_velocity,
        }
    }

    /// The analog input as an encoder that goes on past either end.
    pub(super) const fn analog_encoder(&self) -> Reading {
        Reading {
            position: self.unwrapped().wrapping_add(self.offset),
            velocity: self.analog_velocity,
        }
    }

    /// The counter of rising edges.
    const fn rising_edges(&self) -> Reading {
        Reading {
            position: self.edges,
            velocity: self.edge_velocity,
        }
    }

    /// Sets the turns of the analog encoder: the low 10 bits stay the conversion (manual 13).
    pub(super) fn set_analog_encoder(&mut self, position: i32) {
        self.offset = (position & !TURN_MASK).wrapping_sub(self.unwrapped() & !TURN_MASK);
    }

    /// Sets the counter of rising edges.
    pub(super) fn set_rising_edges(&mut self, position: i32) {
        self.edges = position;
    }
}
