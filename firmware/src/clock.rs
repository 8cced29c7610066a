//! Time since power-on from a tick counter of 32 bits and the time since the latest tick.

use windlass_core::time::{Duration, Instant, TICK};

use crate::control::Crossing;

/// Extends the tick counter to 64 bits. It has to be read at least once in 24 days, which thread mode
/// does in every pass.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock {
    latest: u32,
    wraps: u32,
}

impl Clock {
    /// The time; `micros_of_tick` reads the timer that makes the tick.
    pub fn now(&mut self, crossing: &Crossing, micros_of_tick: impl Fn() -> u32) -> Instant {
        // The tick interrupt may come between the two readings; the second then belongs to another tick.
        let (ticks, micros) = loop {
            let ticks = crossing.ticks();
            let micros = micros_of_tick();
            if ticks == crossing.ticks() {
                break (ticks, micros);
            }
        };
        if ticks < self.latest {
            self.wraps = self.wraps.wrapping_add(1);
        }
        self.latest = ticks;
        let all = u64::from(self.wraps) << 32 | u64::from(ticks);
        Instant::from_micros(all * TICK.as_micros()) + Duration::from_micros(u64::from(micros))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_within_and_over_ticks_and_over_the_counters_end() {
        let crossing = Crossing::new();
        let mut clock = Clock::default();
        assert_eq!(clock.now(&crossing, || 7), Instant::from_micros(7));
        crossing.skip();
        assert_eq!(clock.now(&crossing, || 0), Instant::from_micros(500));
        let mut late = Clock {
            latest: u32::MAX,
            wraps: 0,
        };
        assert_eq!(late.now(&crossing, || 0).as_micros(), ((1 << 32) + 1) * 500);
    }
}
