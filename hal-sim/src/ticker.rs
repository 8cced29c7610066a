//! When which node ticks.

/// Control ticks of all nodes in the order of time. Every node ticks once a period, at a phase of its own.
#[derive(Debug)]
pub(crate) struct Ticker {
    period: u64,
    /// Phases with their nodes, ascending.
    order: Vec<(u64, usize)>,
    /// Position of the next tick in `order`.
    cursor: usize,
    /// Start of the period that is under way.
    start: u64,
}

impl Ticker {
    /// No nodes; times are in ns.
    pub(crate) const fn new(period: u64) -> Self {
        Self {
            period,
            order: Vec::new(),
            cursor: 0,
            start: 0,
        }
    }

    /// Adds a node that ticks `phase` after the start of each period, for the first time after `now`.
    pub(crate) fn add(&mut self, node: usize, phase: u64, now: u64) {
        self.order.push((phase % self.period, node));
        self.order.sort_unstable();
        self.start = now / self.period * self.period;
        let due = |entry: &(u64, usize)| self.start + entry.0 > now;
        self.cursor = match self.order.iter().position(due) {
            Some(position) => position,
            None => {
                self.start += self.period;
                0
            }
        };
    }

    /// Time of the next tick; `u64::MAX` without nodes.
    pub(crate) fn next(&self) -> u64 {
        match self.order.get(self.cursor) {
            Some((phase, _)) => self.start + phase,
            None => u64::MAX,
        }
    }

    /// Takes the next tick; gives its node.
    pub(crate) fn take(&mut self) -> usize {
        let (_, node) = self.order[self.cursor];
        self.cursor += 1;
        if self.cursor == self.order.len() {
            self.cursor = 0;
            self.start += self.period;
        }
        node
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(ticker: &mut Ticker, count: usize) -> Vec<(u64, usize)> {
        (0..count).map(|_| (ticker.next(), ticker.take())).collect()
    }

    #[test]
    fn nodes_tick_in_the_order_of_their_phases() {
        let mut ticker = Ticker::new(500);
        assert_eq!(ticker.next(), u64::MAX);
        ticker.add(0, 0, 0);
        ticker.add(1, 300, 0);
        ticker.add(2, 100, 0);
        let expected = [(100, 2), (300, 1), (500, 0), (600, 2), (800, 1), (1000, 0)];
        assert_eq!(take(&mut ticker, 6), expected);
    }

    #[test]
    fn a_late_node_joins_without_a_tick_being_lost_or_doubled() {
        let mut ticker = Ticker::new(500);
        ticker.add(0, 0, 0);
        ticker.add(1, 300, 0);
        assert_eq!(take(&mut ticker, 3), [(300, 1), (500, 0), (800, 1)]);
        ticker.add(2, 200, 800);
        assert_eq!(take(&mut ticker, 3), [(1000, 0), (1200, 2), (1300, 1)]);
    }
}
