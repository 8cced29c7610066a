//! Incremental encoder with index, and the counter that a controller runs on it.

use windlass_core::engine::snapshot::IndexCapture;

/// Counts per revolution: 1024 cycles of four edges on the motor shaft.
pub const COUNTS_PER_REVOLUTION: f64 = 4096.0;
/// log2 of the counts per revolution: index arithmetic is done by shifts.
const REVOLUTION_SHIFT: u32 = 12;
/// Where the index mark stands, in counts from where the shaft starts: half a revolution away, so that
/// it is passed in either direction and not at power-on.
const INDEX_AT: i64 = 2048;

/// A quadrature encoder of 1024 cycles (4096 counts) per revolution on the motor shaft, channel A
/// leading when the shaft turns forward, index high for one count per revolution; and the 32-bit
/// counter of the controller, which latches its value at index edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Encoder {
    /// Position of the disc in counts, the truth.
    count: i64,
    /// What the counter shows is the truth minus this.
    offset: i64,
    /// Position at which the cable was pulled; the counter stands still.
    unplugged_at: Option<i64>,
    /// Level forced on the index pin.
    forced_index: Option<bool>,
    rising: IndexCapture,
    falling: IndexCapture,
    /// Rising edges of channel A, wrapping.
    a_rises: u16,
}

impl Encoder {
    pub(crate) fn new() -> Self {
        Self {
            count: 0,
            offset: 0,
            unplugged_at: None,
            forced_index: None,
            rising: IndexCapture::default(),
            falling: IndexCapture::default(),
            a_rises: 0,
        }
    }

    /// The controller lost its power: counter and captures start at zero.
    pub(crate) fn restart_counter(&mut self) {
        self.offset = self.count;
        if self.unplugged_at.is_some() {
            self.unplugged_at = Some(self.count);
        }
        self.rising = IndexCapture::default();
        self.falling = IndexCapture::default();
        self.a_rises = 0;
    }

    /// The shaft stands at this position in counts.
    pub(crate) fn turn_to(&mut self, position: f64) {
        let whole = position as i64;
        let count = whole - i64::from(position < whole as f64);
        if count == self.count {
            return;
        }
        let from = self.count;
        self.count = count;
        if self.unplugged_at.is_none() {
            self.a_rises = self.a_rises.wrapping_add(a_rises(from, count));
            if self.forced_index.is_none() {
                self.pass_index(from - INDEX_AT, count - INDEX_AT);
            }
        }
    }

    /// Latches the index edges between two positions that are counted from an index mark. The index is
    /// high at multiples of a revolution and low elsewhere.
    fn pass_index(&mut self, from: i64, to: i64) {
        let turn = |count: i64| count >> REVOLUTION_SHIFT;
        let mark = |turn: i64| turn << REVOLUTION_SHIFT;
        if to > from {
            let entered = turn(to) - turn(from);
            self.latch_rising(entered, mark(turn(to)));
            let left = turn(to - 1) - turn(from - 1);
            self.latch_falling(left, mark(turn(to - 1)) + 1);
        } else {
            let entered = turn(from - 1) - turn(to - 1);
            self.latch_rising(entered, mark(turn(to - 1) + 1));
            let left = turn(from) - turn(to);
            self.latch_falling(left, mark(turn(to) + 1) - 1);
        }
    }

    fn latch_rising(&mut self, edges: i64, at: i64) {
        if edges > 0 {
            self.rising.edges = self.rising.edges.wrapping_add(edges as u16);
            self.rising.count = (at + INDEX_AT - self.offset) as u32;
        }
    }

    fn latch_falling(&mut self, edges: i64, at: i64) {
        if edges > 0 {
            self.falling.edges = self.falling.edges.wrapping_add(edges as u16);
            self.falling.count = (at + INDEX_AT - self.offset) as u32;
        }
    }

    /// Pulls or plugs the cable. The counter misses what happens in between.
    pub(crate) fn set_unplugged(&mut self, unplugged: bool) {
        match (self.unplugged_at, unplugged) {
            (None, true) => self.unplugged_at = Some(self.count),
            (Some(at), false) => {
                self.offset += self.count - at;
                self.unplugged_at = None;
            }
            _ => {}
        }
    }

    /// Forces the index pin to a level, or gives it back to the encoder.
    pub(crate) fn force_index(&mut self, level: Option<bool>) {
        let before = self.index();
        self.forced_index = level;
        let after = self.index();
        let here = self.seen() - INDEX_AT;
        match (before, after) {
            (false, true) => self.latch_rising(1, here),
            (true, false) => self.latch_falling(1, here),
            _ => {}
        }
    }

    /// Level forced on the index pin.
    pub(crate) fn forced_index(&self) -> Option<bool> {
        self.forced_index
    }

    fn seen(&self) -> i64 {
        self.unplugged_at.unwrap_or(self.count)
    }

    /// The controller's counter.
    pub(crate) fn counter(&self) -> u32 {
        (self.seen() - self.offset) as u32
    }

    /// Levels of QEA and QEB; without the cable the pull-ups read high.
    pub(crate) fn channels(&self) -> (bool, bool) {
        if self.unplugged_at.is_some() {
            return (true, true);
        }
        match self.count & 3 {
            0 => (false, false),
            1 => (true, false),
            2 => (true, true),
            _ => (false, true),
        }
    }

    /// Level of QEIDX.
    pub(crate) fn index(&self) -> bool {
        match self.forced_index {
            Some(level) => level,
            None if self.unplugged_at.is_some() => true,
            None => (self.count - INDEX_AT) & ((1 << REVOLUTION_SHIFT) - 1) == 0,
        }
    }

    /// Rising edges of channel A since power-on, wrapping.
    pub(crate) fn a_rises(&self) -> u16 {
        self.a_rises
    }

    /// Latched rising and falling edges of the index.
    pub(crate) fn captures(&self) -> (IndexCapture, IndexCapture) {
        (self.rising, self.falling)
    }
}

/// Rising edges of channel A on the way from one count to another. A is high at counts 1 and 2 of a cycle
/// of four: it rises forward on the way to 1 and backward on the way to 2.
fn a_rises(from: i64, to: i64) -> u16 {
    let passed = if to > from {
        ((to - 1) >> 2) - ((from - 1) >> 2)
    } else {
        ((from - 3) >> 2) - ((to - 3) >> 2)
    };
    passed as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rising_edges_of_channel_a_are_those_that_its_level_shows() {
        let high = |count: i64| matches!(count & 3, 1 | 2);
        for from in -9..9_i64 {
            for to in -9..9_i64 {
                let step = (to - from).signum();
                let (mut at, mut rises) = (from, 0);
                while at != to {
                    at += step;
                    rises += u16::from(high(at) && !high(at - step));
                }
                assert_eq!(a_rises(from, to), rises, "{from} to {to}");
            }
        }
    }

    /// Counts index edges the slow way, one count after the other.
    fn walk(positions: &[i64]) -> (IndexCapture, IndexCapture) {
        let (mut rising, mut falling) = (IndexCapture::default(), IndexCapture::default());
        let high = |count: i64| (count - INDEX_AT).rem_euclid(4096) == 0;
        let mut at = 0_i64;
        for &target in positions {
            while at != target {
                let next = at + (target - at).signum();
                if high(next) && !high(at) {
                    rising.edges += 1;
                    rising.count = next as u32;
                }
                if !high(next) && high(at) {
                    falling.edges += 1;
                    falling.count = next as u32;
                }
                at = next;
            }
        }
        (rising, falling)
    }

    #[test]
    fn index_edges_are_those_of_a_count_by_count_walk() {
        let positions = [
            2047, 2048, 2049, 2048, 2047, 2050, -2047, -2048, -2049, -2048, 0, 20_000, -20_000,
            2048, 2049, 2048, 5000, 2048, 2047, 2048,
        ];
        let mut encoder = Encoder::new();
        for end in 1..=positions.len() {
            encoder.turn_to(positions[end - 1] as f64 + 0.5);
            assert_eq!(encoder.captures(), walk(&positions[..end]), "{end}");
        }
    }

    #[test]
    fn counts_round_towards_minus_infinity_and_wrap() {
        let mut encoder = Encoder::new();
        encoder.turn_to(-0.5);
        assert_eq!(encoder.counter(), u32::MAX);
        encoder.turn_to(-1.0);
        assert_eq!(encoder.counter(), u32::MAX);
        encoder.turn_to(1.0);
        assert_eq!(encoder.counter(), 1);
        encoder.turn_to(4_294_967_297.5);
        assert_eq!(encoder.counter(), 1);
    }

    #[test]
    fn a_leads_b_forward() {
        let mut encoder = Encoder::new();
        let mut seen = Vec::new();
        for count in 0..4 {
            encoder.turn_to(f64::from(count));
            seen.push(encoder.channels());
        }
        let expected = [(false, false), (true, false), (true, true), (false, true)];
        assert_eq!(seen, expected);
    }

    #[test]
    fn a_pulled_cable_freezes_the_counter() {
        let mut encoder = Encoder::new();
        encoder.turn_to(100.0);
        encoder.set_unplugged(true);
        encoder.turn_to(5000.0);
        assert_eq!(encoder.counter(), 100);
        assert_eq!((encoder.channels(), encoder.index()), ((true, true), true));
        assert_eq!(encoder.captures().0.edges, 0);
        encoder.set_unplugged(false);
        encoder.turn_to(5010.0);
        assert_eq!(encoder.counter(), 110);
    }

    #[test]
    fn the_index_pin_can_be_toggled_by_hand() {
        let mut encoder = Encoder::new();
        encoder.turn_to(700.0);
        assert!(!encoder.index());
        encoder.force_index(Some(true));
        assert_eq!(
            encoder.captures().0,
            IndexCapture {
                edges: 1,
                count: 700
            }
        );
        encoder.turn_to(800.0);
        encoder.force_index(Some(false));
        assert_eq!(
            encoder.captures().1,
            IndexCapture {
                edges: 1,
                count: 800
            }
        );
        encoder.force_index(None);
        assert_eq!(encoder.captures().1.edges, 1);
    }

    #[test]
    fn power_loss_zeroes_the_counter_but_not_the_shaft() {
        let mut encoder = Encoder::new();
        encoder.turn_to(3000.0);
        encoder.restart_counter();
        assert_eq!((encoder.counter(), encoder.captures().0.edges), (0, 0));
        encoder.turn_to(3000.0 + 4096.0);
        assert_eq!(encoder.counter(), 4096);
        assert_eq!(encoder.captures().0.count, 6144 - 3000);
    }
}
