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
    /// The text of one descriptor, if one has been set.
    #[must_use]
    pub fn stored(&self, which: Descriptor) -> Option<&[u8]> {
        self.texts.get(which as usize - 1)?.as_deref()
    }

    /// One descriptor reports its default again.
    pub fn clear(&mut self, which: Descriptor) {
        if let Some(slot) = self.texts.get_mut(which as usize - 1) {
            *slot = None;
        }
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

/// What is known of the settings in force and of those in non-volatile memory (`paramSettingsState`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SettingsState {
    /// Both are the same.
    #[default]
    Saved = 0,
    /// Something has changed and will be written in time.
    Pending = 1,
    /// Something is due to be written, which takes an erase, which waits until the drive is off.
    EraseDue = 2,
    /// What is stored is of a newer firmware's format: it is not in force, and nothing is written.
    NewerFormat = 3,
}

impl SettingsState {
    /// Every state.
    pub const ALL: [Self; 4] = [
        Self::Saved,
        Self::Pending,
        Self::EraseDue,
        Self::NewerFormat,
    ];

    /// The state's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Saved => "saved",
            Self::Pending => "pending",
            Self::EraseDue => "erase due",
            Self::NewerFormat => "newer format",
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

    /// Forgets sticky faults and counts.
    pub fn clear(&mut self) {
        self.sticky = Faults::NONE;
        self.counts = [0; 5];
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

/// The 15 s of both rules (DMC60C guide, "Configuration Parameters"; Talon SRX manual 11.1).
pub const QUIET_TIME: Duration = Duration::from_millis(15_000);

/// When changed settings are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SaveRule {
    /// At once if nothing has changed for 15 s, else after 15 s without a change.
    #[default]
    AfterQuiet,
    /// At once, but not before 15 s have passed since they were written last.
    SinceLastSave,
}

/// Tells when changed settings are to be written.
#[derive(Clone, Copy, Debug, Default)]
pub struct SaveTimer {
    rule: SaveRule,
    last_change: Option<Instant>,
    last_save: Option<Instant>,
    due: Option<Instant>,
}

impl SaveTimer {
    /// Nothing has changed yet.
    #[must_use]
    pub const fn new(rule: SaveRule) -> Self {
        Self {
            rule,
            last_change: None,
            last_save: None,
            due: None,
        }
    }

    /// Something that is stored has changed.
    pub fn changed(&mut self, now: Instant) {
        let since = |then: Option<Instant>| then.is_none_or(|then| now.since(then) >= QUIET_TIME);
        self.due = Some(match self.rule {
            SaveRule::AfterQuiet if since(self.last_change) => now,
            SaveRule::AfterQuiet => now + QUIET_TIME,
            SaveRule::SinceLastSave => match (self.due, self.last_save) {
                (Some(due), _) => due,
                (None, Some(last)) if !since(self.last_save) => last + QUIET_TIME,
                _ => now,
            },
        });
        self.last_change = Some(now);
    }

    /// When the changes are to be written, if there are any.
    #[must_use]
    pub const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// The changes so far are being written.
    pub const fn begin(&mut self) {
        self.due = None;
    }

    /// They have been written. What has changed in the meantime is still to come.
    pub fn saved(&mut self, now: Instant) {
        self.last_save = Some(now);
        if self.rule == SaveRule::SinceLastSave && self.due.is_some() {
            self.due = Some(now + QUIET_TIME);
        }
    }

    /// They could not be written: once more after 15 s.
    pub fn failed(&mut self, now: Instant) {
        self.due = Some(now + QUIET_TIME);
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
        timer.begin();
        timer.saved(at(101));
        assert_eq!(timer.due(), None);
        timer.changed(at(5_000));
        assert_eq!(timer.due(), Some(at(20_000)));
        timer.changed(at(9_000));
        assert_eq!(timer.due(), Some(at(24_000)));
        timer.begin();
        timer.saved(at(24_000));
        timer.changed(at(24_000));
        assert_eq!(timer.due(), Some(at(24_000)));
    }

    #[test]
    fn by_the_other_rule_15_s_pass_from_one_save_to_the_next_to_the_microsecond() {
        let mut timer = SaveTimer::new(SaveRule::SinceLastSave);
        timer.changed(at(100));
        assert_eq!(timer.due(), Some(at(100)));
        timer.begin();
        timer.saved(at(103));
        // Changes do not push the save away.
        for millis in [104, 5_000, 15_102] {
            timer.changed(at(millis));
            assert_eq!(timer.due(), Some(at(15_103)));
        }
        timer.begin();
        timer.saved(at(15_103));
        timer.changed(at(30_103));
        assert_eq!(timer.due(), Some(at(30_103)));
        timer.begin();
        // A change while the set is being written is not in it.
        timer.changed(at(30_104));
        timer.saved(at(30_106));
        assert_eq!(timer.due(), Some(at(45_106)));
    }

    #[test]
    fn a_failed_save_is_tried_again() {
        for rule in [SaveRule::AfterQuiet, SaveRule::SinceLastSave] {
            let mut timer = SaveTimer::new(rule);
            timer.changed(at(0));
            timer.begin();
            timer.failed(at(1));
            assert_eq!(timer.due(), Some(at(15_001)));
        }
    }

    #[test]
    fn descriptors_are_cut_at_their_capacity_and_absent_until_set() {
        let mut descriptors = Descriptors::default();
        for which in Descriptor::ALL {
            assert_eq!(descriptors.stored(which), None);
            descriptors.set(which, &[b'x'; 100]);
            assert_eq!(descriptors.stored(which).unwrap().len(), which.capacity());
            descriptors.set(which, b"");
            assert_eq!(descriptors.stored(which), Some(&b""[..]));
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
