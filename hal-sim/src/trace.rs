//! The last frames that were on the bus.

use std::collections::VecDeque;

use windlass_core::frame::Frame;
use windlass_core::time::Instant;

use crate::bus::Station;

/// Frames that the ring holds.
pub const TRACE_CAPACITY: usize = 100_000;

/// Who sent a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The node with this index.
    Node(usize),
    /// The CAN tool that joined under this name.
    Participant(String),
}

/// One frame that was on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TraceEntry {
    /// Number of the frame since the world began, from 0, without gaps.
    pub seq: u64,
    /// End of the frame.
    pub at: Instant,
    /// The frame.
    pub frame: Frame,
    /// Who sent it. Of several who sent the same bits at the same moment, the one that joined first.
    pub from: Source,
}

/// What the ring keeps of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Traced {
    pub(crate) at: Instant,
    pub(crate) frame: Frame,
    pub(crate) from: Station,
}

/// Ring of the last frames.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    entries: VecDeque<Traced>,
    /// Number of the oldest entry.
    first: u64,
}

impl Trace {
    pub(crate) fn push(&mut self, entry: Traced) {
        if self.entries.len() == TRACE_CAPACITY {
            self.entries.pop_front();
            self.first += 1;
        }
        self.entries.push_back(entry);
    }

    /// Up to `limit` entries from number `seq` on; older ones than the ring holds are skipped.
    pub(crate) fn since(&self, seq: u64, limit: usize) -> impl Iterator<Item = (u64, &Traced)> {
        let skip = usize::try_from(seq.saturating_sub(self.first)).unwrap_or(usize::MAX);
        let first = self.first;
        self.entries
            .iter()
            .enumerate()
            .skip(skip)
            .take(limit)
            .map(move |(index, entry)| (first + index as u64, entry))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(frames: u64) -> Trace {
        let mut trace = Trace::default();
        for at in 0..frames {
            trace.push(Traced {
                at: Instant::from_micros(at),
                frame: Frame::standard(0, []),
                from: 0,
            });
        }
        trace
    }

    fn numbers(trace: &Trace, seq: u64, limit: usize) -> Vec<u64> {
        trace
            .since(seq, limit)
            .map(|(seq, entry)| {
                assert_eq!(entry.at.as_micros(), seq);
                seq
            })
            .collect()
    }

    #[test]
    fn numbers_go_on_when_the_oldest_are_dropped() {
        let trace = filled(TRACE_CAPACITY as u64 + 10);
        assert_eq!(numbers(&trace, 0, 2), [10, 11]);
        let last = TRACE_CAPACITY as u64 + 9;
        assert_eq!(numbers(&trace, last, 5), [last]);
        assert_eq!(numbers(&trace, last + 1, 5), [0; 0]);
    }

    #[test]
    fn a_limit_pages_through() {
        let trace = filled(5);
        assert_eq!(numbers(&trace, 0, 3), [0, 1, 2]);
        assert_eq!(numbers(&trace, 3, 3), [3, 4]);
    }
}
