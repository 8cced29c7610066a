//! Counting in the tick: a position of 32 bits from a hardware counter of 16, edges of a pin, and pulses.

use windlass_core::engine::snapshot::{IndexCapture, Pulse};

/// Follows a quadrature counter of 16 bits, which has to be read at least once every 32,767 counts: once a
/// tick is enough up to 65 million counts per second.
#[derive(Clone, Copy, Debug, Default)]
pub struct Position(u32);

impl Position {
    /// Counter at 0.
    #[must_use]
    pub const fn new() -> Self {
        Self(0)
    }

    /// The position at the present count; wraps.
    pub fn follow(&mut self, count: u16) -> u32 {
        self.0 = self.near(count);
        self.0
    }

    /// The position at a count that was captured a short while ago.
    #[must_use]
    pub fn near(&self, count: u16) -> u32 {
        let step = count.wrapping_sub(self.0 as u16) as i16;
        self.0.wrapping_add_signed(i32::from(step))
    }

    /// An index edge with its captured count.
    #[must_use]
    pub fn index(&self, (edges, count): (u16, u16)) -> IndexCapture {
        IndexCapture {
            edges,
            count: self.near(count),
        }
    }
}

/// Counts rising edges of a pin that is read once a tick. The timers count quadrature and no single channel,
/// so a level that lasts for less than a tick is missed: good for 1000 edges a second.
#[derive(Clone, Copy, Debug)]
pub struct Rises {
    low: bool,
    edges: u16,
}

impl Rises {
    /// No edge yet; the pin has been high, as its pull-up makes it.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            low: false,
            edges: 0,
        }
    }

    /// Edges so far, wrapping, with this level now.
    pub fn follow(&mut self, level: bool) -> u16 {
        if level && self.low {
            self.edges = self.edges.wrapping_add(1);
        }
        self.low = !level;
        self.edges
    }
}

impl Default for Rises {
    fn default() -> Self {
        Self::new()
    }
}

/// Counts RC-PWM pulses from what a timer has captured.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pulses {
    started: bool,
    pulse: Pulse,
}

impl Pulses {
    /// No pulse yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            started: false,
            pulse: Pulse {
                width_us: 0,
                count: 0,
            },
        }
    }

    /// The latest pulse, after a tick in which the timer shows that it has `risen` at any time, and perhaps the width
    /// of a pulse that has ended. An end whose beginning nobody saw, at power-on, is no pulse.
    pub fn follow(&mut self, risen: bool, width_us: Option<u16>) -> Pulse {
        self.started |= risen;
        if let (true, Some(width_us)) = (self.started, width_us) {
            self.pulse = Pulse {
                width_us,
                count: self.pulse.count.wrapping_add(1),
            };
        }
        self.pulse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_counts_when_it_ends_and_only_if_it_was_seen_to_begin() {
        let mut pulses = Pulses::new();
        let mut follow = |risen, width| {
            let Pulse { width_us, count } = pulses.follow(risen, width);
            (width_us, count)
        };
        assert_eq!(follow(false, None), (0, 0));
        // High since before the timer has started.
        assert_eq!(follow(false, Some(1234)), (0, 0));
        assert_eq!(follow(true, None), (0, 0));
        assert_eq!(follow(true, Some(1500)), (1500, 1));
        assert_eq!(follow(true, None), (1500, 1));
        assert_eq!(follow(true, Some(1500)), (1500, 2));
    }

    #[test]
    fn only_rising_edges_are_counted() {
        let mut rises = Rises::new();
        let seen = [true, false, false, true, true, false, true].map(|level| rises.follow(level));
        assert_eq!(seen, [0, 0, 0, 1, 1, 1, 2]);
    }

    #[test]
    fn a_position_goes_on_over_the_counters_ends_in_both_directions() {
        let mut position = Position::new();
        let mut expected: u32 = 0;
        for step in [1, 30_000, 32_767, 32_767, -32_768, -32_767, -32_768, -3] {
            expected = expected.wrapping_add_signed(step);
            assert_eq!(position.follow(expected as u16), expected);
        }
        assert_eq!(expected as i32, -2771);
    }

    #[test]
    fn a_capture_lies_near_the_position_on_either_side() {
        let mut position = Position::new();
        for _ in 0..3 {
            let at = position.near(30_000);
            position.follow(at as u16);
            position.follow(at.wrapping_add(30_000) as u16);
        }
        let now = position.follow(5);
        for distance in [-100, 0, 100] {
            let at = now.wrapping_add_signed(distance);
            let capture = position.index((7, at as u16));
            assert_eq!((capture.edges, capture.count), (7, at));
        }
    }
}
