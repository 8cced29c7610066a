//! Periodic frames.

use crate::time::{Duration, Instant};

/// When one kind of periodic frame is due.
///
/// The first frame comes one full period after the start, and each later one a period after the time the
/// last was due, so that waiting for the bus does not shift the rhythm. A frame that is still waiting when
/// the next falls due is not sent twice.
#[derive(Clone, Copy, Debug, Default)]
pub struct Periodic {
    period: Duration,
    due: Option<Instant>,
}

impl Periodic {
    /// Starts the rhythm.
    // Not inlined, as `take`: every periodic frame of every dialect would have a copy.
    #[inline(never)]
    pub fn start(&mut self, now: Instant, period: Duration) {
        self.period = period;
        self.due = Some(now + period);
    }

    /// Ends the rhythm.
    pub fn stop(&mut self) {
        self.due = None;
    }

    /// When the next frame is due; nothing while stopped.
    #[must_use]
    pub const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// True once for every frame that is due. A changed period starts a new rhythm.
    #[inline(never)]
    pub fn take(&mut self, now: Instant, period: Duration) -> bool {
        let Some(due) = self.due else { return false };
        if period != self.period {
            self.start(now, period);
            return false;
        }
        if now < due {
            return false;
        }
        let next = due + period;
        self.due = Some(if next > now { next } else { now + period });
        true
    }
}

/// The earlier of two deadlines.
#[must_use]
pub fn earlier(a: Option<Instant>, b: Option<Instant>) -> Option<Instant> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u32) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    #[test]
    fn a_late_frame_does_not_shift_the_rhythm() {
        let period = Duration::from_millis(10);
        let mut frames = Periodic::default();
        assert!(!frames.take(at(0), period));
        frames.start(at(0), period);
        assert!(!frames.take(at(9), period));
        assert!(frames.take(at(13), period));
        assert!(!frames.take(at(19), period));
        assert!(frames.take(at(20), period));
        // Three periods blocked: one frame, not three.
        assert!(frames.take(at(51), period));
        assert!(!frames.take(at(52), period));
    }

    #[test]
    fn a_changed_period_counts_from_the_change() {
        let mut frames = Periodic::default();
        frames.start(at(0), Duration::from_millis(100));
        assert!(!frames.take(at(50), Duration::from_millis(20)));
        assert!(!frames.take(at(69), Duration::from_millis(20)));
        assert!(frames.take(at(70), Duration::from_millis(20)));
    }
}
