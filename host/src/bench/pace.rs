//! How fast virtual time follows the wall clock.

use std::time::{Duration, Instant};

/// A bench further behind the wall clock than this gives up the difference.
const LARGEST_LAG: Duration = Duration::from_millis(50);

/// How virtual time passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Only by `POST /api/sim/step`.
    Paused,
    /// This many virtual seconds in each second of the wall clock, more than 0.
    RealTime(f64),
}

/// Follows the wall clock at a constant speed.
///
/// A bench that falls behind catches up, but never by more than [`LARGEST_LAG`]: what a client sees
/// after a pause of the machine is a late bus, not a second of traffic in one burst.
#[derive(Debug)]
pub(super) struct Pacer {
    speed: f64,
    wall_start: Instant,
    virtual_start_us: u64,
    slips: u64,
}

impl Pacer {
    /// A pacer that holds `now_us` and `wall` to be the same moment.
    pub(super) fn new(speed: f64, wall: Instant, now_us: u64) -> Self {
        Self {
            speed,
            wall_start: wall,
            virtual_start_us: now_us,
            slips: 0,
        }
    }

    pub(super) fn speed(&self) -> f64 {
        self.speed
    }

    /// How often time was given up.
    pub(super) fn slips(&self) -> u64 {
        self.slips
    }

    /// Virtual microseconds in `span` of wall time.
    pub(super) fn virtual_us(&self, span: Duration) -> u64 {
        (span.as_secs_f64() * self.speed * 1e6).round() as u64
    }

    /// How many microseconds virtual time is due to advance from `now_us` at the moment `wall`.
    pub(super) fn due_us(&mut self, wall: Instant, now_us: u64) -> u64 {
        let elapsed = self.virtual_us(wall.saturating_duration_since(self.wall_start));
        let behind = (self.virtual_start_us + elapsed).saturating_sub(now_us);
        let largest = self.virtual_us(LARGEST_LAG);
        if behind <= largest {
            return behind;
        }
        self.slips += 1;
        self.wall_start = wall;
        self.virtual_start_us = now_us + largest;
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn virtual_time_follows_at_the_given_speed() {
        let start = Instant::now();
        let mut pacer = Pacer::new(20.0, start, 500);
        assert_eq!(pacer.due_us(start, 500), 0);
        assert_eq!(pacer.due_us(start + MS, 500), 20_000);
        assert_eq!(pacer.due_us(start + 2 * MS, 20_500), 20_000);
        assert_eq!(pacer.slips(), 0);
    }

    #[test]
    fn a_short_pause_is_caught_up() {
        let start = Instant::now();
        let mut pacer = Pacer::new(1.0, start, 0);
        assert_eq!(pacer.due_us(start + 49 * MS, 0), 49_000);
        assert_eq!(pacer.due_us(start + 50 * MS, 49_000), 1_000);
        assert_eq!(pacer.slips(), 0);
    }

    #[test]
    fn a_long_pause_slips_once_and_time_goes_on_evenly() {
        let start = Instant::now();
        let mut pacer = Pacer::new(1.0, start, 0);
        assert_eq!(pacer.due_us(start + 1000 * MS, 0), 50_000);
        assert_eq!(pacer.slips(), 1);
        assert_eq!(pacer.due_us(start + 1001 * MS, 50_000), 1_000);
        assert_eq!(pacer.due_us(start + 1002 * MS, 51_000), 1_000);
        assert_eq!(pacer.slips(), 1);
    }
}
