//! The node's settings as a set of the journal.

use embedded_storage::nor_flash::NorFlash;

use super::{Content, Entry, Journal, Key, Sink};
use crate::engine::snapshot::Faults;
use crate::management::vendor::Descriptor;
use crate::management::wire::MAX_DEVICE_NUMBER;
use crate::params::Stored;
use crate::params::table::{ParameterId, RULES, Storage};

/// The descriptor that a key is about.
fn descriptor(key: Key) -> Option<Descriptor> {
    Descriptor::ALL
        .into_iter()
        .find(|which| Key::text(*which) == key)
}

impl Content for Stored {
    fn owns(&self, key: Key) -> bool {
        match key {
            // Parameters that another version of the firmware knows are kept for it.
            Key::Parameter(id) => ParameterId::from_code(id).is_some(),
            Key::NUMBER | Key::STICKY_FAULTS | Key::FAULT_COUNTS => true,
            key => descriptor(key).is_some(),
        }
    }

    /// What is at its default takes no room.
    fn put(&self, sink: &mut dyn Sink) {
        if self.number != 0 {
            sink.entry(Key::NUMBER, &[self.number]);
        }
        for which in Descriptor::ALL {
            if let Some(text) = self.descriptors.stored(which) {
                sink.entry(Key::text(which), text);
            }
        }
        for row in &RULES {
            let value = self.params.get(row.id);
            if row.storage == Storage::Persistent && value != row.default {
                // Without the zeros at the upper end.
                let used = 4 - value.leading_zeros() as usize / 8;
                let bytes = value.to_le_bytes();
                let bytes = bytes.get(..used).unwrap_or(&bytes);
                sink.entry(Key::Parameter(row.id.code()), bytes);
            }
        }
        if !self.sticky.is_empty() {
            sink.entry(Key::STICKY_FAULTS, &[self.sticky.bits()]);
        }
        if self.fault_counts != [0; 4] {
            sink.entry(Key::FAULT_COUNTS, &self.fault_counts);
        }
    }
}

impl Stored {
    /// The settings in force. What the set does not hold, or what this firmware does not allow, is at its
    /// default.
    #[must_use]
    pub fn load<F: NorFlash>(journal: &Journal, flash: &mut F) -> Self {
        let mut stored = Self {
            sequence: journal.sequence(),
            ..Self::default()
        };
        for entry in journal.entries(flash) {
            stored.take(&entry);
        }
        stored
    }

    fn take(&mut self, entry: &Entry) {
        match (entry.key, entry.value.as_slice()) {
            (Key::NUMBER, [number]) if *number <= MAX_DEVICE_NUMBER => self.number = *number,
            (Key::STICKY_FAULTS, [bits]) => self.sticky = Faults::from_bits(*bits),
            (Key::FAULT_COUNTS, [a, b, c, d]) => self.fault_counts = [*a, *b, *c, *d],
            (Key::Parameter(id), bytes) => self.take_parameter(id, bytes),
            (key, text) => {
                if let Some(which) = descriptor(key) {
                    self.descriptors.set(which, text);
                }
            }
        }
    }

    fn take_parameter(&mut self, id: u8, bytes: &[u8]) {
        let Some(id) = ParameterId::from_code(id) else {
            return;
        };
        if id.rule().storage == Storage::Persistent && bytes.len() <= 4 {
            let value = bytes
                .iter()
                .rev()
                .fold(0, |value, byte| value << 8 | u32::from(*byte));
            // A value that is not allowed leaves the default.
            let _ = self.params.set(id, value);
        }
    }
}
