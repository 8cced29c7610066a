//! What is kept over a power cycle, and when it is written.
//!
//! The platform keeps one [`Stored`] set: it hands the latest one to the node at start and writes a new
//! one when the node asks. How it does that (RAM on the bench, a journal in flash) is no concern here.

use heapless::Vec;

use super::Params;
use crate::engine::snapshot::{Fault, Faults, Snapshot};
use crate::management::vendor::Descriptor;
use crate::time::{Duration, Instant};

/// Longest descriptor in bytes.
pub const TEXT_CAPACITY: usize = 64;

/// Text of a descriptor, without terminator. Bytes are kept as they came.
pub type Text = Vec<u8, TEXT_CAPACITY>;

/// The six strings that describe a device; unset ones report their default.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Descriptors {
    texts: [Option<Text>; 6],
}

impl Clone for Descriptors {
    /// Element by element: the clone of a whole array leaves a panic path in the machine code.
    fn clone(&self) -> Self {
        Self {
            texts: core::array::from_fn(|at| copied(self.texts.get(at))),
        }
    }
}

/// One text copied. Not inlined: six copies of it would be a kilobyte of machine code.
#[inline(never)]
fn copied(text: Option<&Option<Text>>) -> Option<Text> {
    text.cloned().flatten()
}

impl Descriptors {
    /// The text of one descriptor.
    #[must_use]
    pub fn get(&self, which: Descriptor) -> &[u8] {
        match self.texts.get(which as usize - 1) {
            Some(Some(text)) => text,
            _ => which.default_text().as_bytes(),
        }
    }

    /// The text of one descriptor, if one has been set.
    #[must_use]
    pub fn stored(&self, which: Descriptor) -> Option<&[u8]> {
        self.texts.get(which as usize - 1)?.as_deref()
    }

    /// Replaces one descriptor; text beyond its capacity is cut off.
    pub fn set(&mut self, which: Descriptor, text: &[u8]) {
        let kept = text.get(..which.capacity().min(text.len())).unwrap_or(&[]);
        if let (Some(slot), Ok(text)) = (
            self.texts.get_mut(which as usize - 1),
            Text::from_slice(kept),
        ) {
            *slot = Some(text);
        }
    }
}

/// Everything that is kept over a power cycle, always read and written whole.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// Device number, 0 = none assigned.
    pub number: u8,
    /// Descriptors.
    pub descriptors: Descriptors,
    /// Parameters; only the persistent ones count.
    pub params: Params,
    /// Sticky faults.
    pub sticky: Faults,
    /// Counts of the faults with bits 0 to 3.
    pub fault_counts: [u8; 4],
    /// Grows by one with every write (`vcmdGetFlashSeqnum`).
    pub sequence: u32,
}

/// Sticky faults and their counts (guide, `paramStickyFaults` and the counts after it).
///
/// Counts saturate at 255 and are independent of the sticky bits. The communication count is kept in RAM
/// only.
#[derive(Clone, Debug, Default)]
pub struct FaultLog {
    sticky: Faults,
    counts: [u8; 5],
    seen: [u8; 4],
}

impl FaultLog {
    /// The log as it was stored; the communication fault count starts at zero.
    #[must_use]
    pub fn new(stored: &Stored) -> Self {
        let [a, b, c, d] = stored.fault_counts;
        Self {
            sticky: stored.sticky,
            counts: [a, b, c, d, 0],
            seen: [0; 4],
        }
    }

    /// Takes over the engine's fault events; true if anything was new.
    pub fn observe(&mut self, snapshot: &Snapshot) -> bool {
        let mut changed = false;
        for (fault, (event, seen)) in Fault::ALL
            .into_iter()
            .zip(snapshot.fault_events.iter().zip(&mut self.seen))
        {
            let new = event.wrapping_sub(*seen);
            *seen = *event;
            if new != 0 {
                self.sticky = self.sticky.with(fault);
                if let Some(count) = self.counts.get_mut(fault as usize) {
                    *count = count.saturating_add(new);
                }
                changed = true;
            }
        }
        changed
    }

    /// Makes faults sticky without counting them; true if one of them was not.
    pub fn keep(&mut self, faults: Faults) -> bool {
        let before = self.sticky;
        self.sticky = before.union(faults);
        self.sticky != before
    }

    /// Records one fault that is not the engine's.
    pub fn record(&mut self, fault: Fault) {
        self.sticky = self.sticky.with(fault);
        if let Some(count) = self.counts.get_mut(fault as usize) {
            *count = count.saturating_add(1);
        }
    }

    /// Faults that have occurred since they were last cleared.
    #[must_use]
    pub const fn sticky(&self) -> Faults {
        self.sticky
    }

    /// Times that a fault has occurred.
    #[must_use]
    pub fn count(&self, fault: Fault) -> u8 {
        self.counts.get(fault as usize).copied().unwrap_or(0)
    }

    /// Forgets the sticky faults; the counts stay.
    pub fn clear_sticky(&mut self) {
        self.sticky = Faults::NONE;
    }

    /// Forgets one count; the sticky fault stays.
    pub fn clear_count(&mut self, fault: Fault) {
        if let Some(count) = self.counts.get_mut(fault as usize) {
            *count = 0;
        }
    }

    /// The part that is stored.
    #[must_use]
    pub const fn stored_counts(&self) -> [u8; 4] {
        let [a, b, c, d, _] = self.counts;
        [a, b, c, d]
    }
}

/// How long nothing may change before changes are written (guide, "Configuration Parameters").
pub const QUIET_TIME: Duration = Duration::from_millis(15_000);

/// The 15 s rule: a change is written at once if nothing has changed for 15 s, else after 15 s without a
/// change.
#[derive(Clone, Copy, Debug, Default)]
pub struct SaveTimer {
    last_change: Option<Instant>,
    due: Option<Instant>,
}

impl SaveTimer {
    /// Something that is stored has changed.
    pub fn changed(&mut self, now: Instant) {
        let quiet = self
            .last_change
            .is_none_or(|last| now.since(last) >= QUIET_TIME);
        self.last_change = Some(now);
        self.due = Some(if quiet { now } else { now + QUIET_TIME });
    }

    /// When the changes are to be written, if there are any.
    #[must_use]
    pub const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// The changes have been written.
    pub fn saved(&mut self) {
        self.due = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u32) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    #[test]
    fn first_change_is_written_at_once_and_the_next_after_15_quiet_seconds() {
        let mut timer = SaveTimer::default();
        timer.changed(at(100));
        assert_eq!(timer.due(), Some(at(100)));
        timer.saved();
        assert_eq!(timer.due(), None);
        timer.changed(at(5_000));
        assert_eq!(timer.due(), Some(at(20_000)));
        timer.changed(at(9_000));
        assert_eq!(timer.due(), Some(at(24_000)));
        timer.saved();
        timer.changed(at(24_000));
        assert_eq!(timer.due(), Some(at(24_000)));
    }

    #[test]
    fn descriptors_are_cut_at_their_capacity_and_default_until_set() {
        let mut descriptors = Descriptors::default();
        for which in Descriptor::ALL {
            assert_eq!(descriptors.get(which), which.default_text().as_bytes());
            descriptors.set(which, &[b'x'; 100]);
            assert_eq!(descriptors.get(which).len(), which.capacity());
            descriptors.set(which, b"");
            assert_eq!(descriptors.get(which), b"");
        }
    }

    #[test]
    fn counts_saturate_and_are_cleared_apart_from_the_sticky_bits() {
        let mut log = FaultLog::default();
        let mut snapshot = Snapshot::default();
        for _ in 0..300 {
            snapshot.fault_events[2] = snapshot.fault_events[2].wrapping_add(1);
            assert!(log.observe(&snapshot));
            assert!(!log.observe(&snapshot));
        }
        assert_eq!(log.count(Fault::UnderVoltage), 255);
        log.clear_sticky();
        assert_eq!(log.count(Fault::UnderVoltage), 255);
        log.record(Fault::Communication);
        log.clear_count(Fault::UnderVoltage);
        assert_eq!(log.count(Fault::UnderVoltage), 0);
        assert!(log.sticky().contains(Fault::Communication));
    }
}
