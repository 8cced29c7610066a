//! Session ids.

use crate::time::Instant;

/// Source of session ids.
///
/// They are 16 bits of a 64 MHz timer on the DMC60C, and never 0. Here the board's seed and all events so
/// far take part, so that boards that were switched on together still differ.
#[derive(Clone, Debug)]
pub struct SessionIds(u32);

impl SessionIds {
    /// A source; `seed` differs from board to board.
    #[must_use]
    pub const fn new(seed: u32) -> Self {
        Self(seed)
    }

    /// The next session id.
    pub fn draw(&mut self, now: Instant) -> u16 {
        // Xorshift32 (Marsaglia 2003), whose state must not be 0.
        let mut x = (self.0 ^ now.as_micros() as u32).max(1);
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        self.0 = x;
        ((x >> 16) as u16).max(1)
    }
}
