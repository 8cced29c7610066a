//! Time as a value. Nothing in this crate reads a clock: every call that depends on time takes an
//! [`Instant`] from its caller, which makes a log replayable and a test independent of the machine.

use core::ops::{Add, Sub};

/// Period of the control tick (DMC60C guide, "Output Control Protocol": the loop runs every 500 µs).
pub const TICK: Duration = Duration::from_micros(500);

/// Control ticks in one millisecond.
pub const TICKS_PER_MS: u32 = 2;

/// A point in time: microseconds since the controller was powered on.
///
/// 64 bits do not wrap in the life of a controller, so instants compare with `<`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant(u64);

impl Instant {
    /// Power-on.
    pub const ZERO: Self = Self(0);

    /// The instant `micros` microseconds after power-on.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// Microseconds since power-on.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }

    /// Time passed since `earlier`; zero if `earlier` lies in the future.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }
}

/// A span of time in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Duration(u64);

impl Duration {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// A span of `micros` microseconds.
    #[must_use]
    pub const fn from_micros(micros: u64) -> Self {
        Self(micros)
    }

    /// A span of `millis` milliseconds.
    #[must_use]
    pub const fn from_millis(millis: u32) -> Self {
        Self(millis as u64 * 1000)
    }

    /// A span of `ticks` control ticks of 500 µs.
    #[must_use]
    pub const fn from_ticks(ticks: u32) -> Self {
        Self(ticks as u64 * TICK.0)
    }

    /// The span in microseconds.
    #[must_use]
    pub const fn as_micros(self) -> u64 {
        self.0
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl Sub<Duration> for Instant {
    type Output = Self;
    fn sub(self, span: Duration) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_is_half_a_millisecond() {
        assert_eq!(Duration::from_ticks(TICKS_PER_MS), Duration::from_millis(1));
        assert_eq!(Duration::from_millis(104), Duration::from_ticks(208));
    }

    #[test]
    fn arithmetic_saturates_instead_of_wrapping() {
        let end = Instant::from_micros(u64::MAX);
        assert_eq!(end + TICK, end);
        assert_eq!(Instant::ZERO - TICK, Instant::ZERO);
        assert_eq!(Instant::ZERO.since(end), Duration::ZERO);
    }
}
