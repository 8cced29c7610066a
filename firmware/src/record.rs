//! Why the controller restarted: a record in RAM that survives a reset but not a loss of power.

use core::sync::atomic::{AtomicU32, Ordering};

use windlass_core::node::Handover;

/// Tells a record from what RAM holds after power-on.
const MAGIC: u32 = 0x5EC0_57A7;

/// Why the program ended itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A restart that was asked for over the bus.
    Requested(Handover),
    /// A panic; the line of the source and a hash of the file's name (FNV-1a) tell where.
    Panic {
        /// Line.
        line: u32,
        /// Hash of the file's name.
        file: u32,
    },
    /// A fault of the processor.
    HardFault {
        /// Configurable Fault Status Register.
        status: u32,
        /// Faulting address, if the status says that it is valid.
        address: u32,
    },
    /// An interrupt came that nothing handles.
    UnexpectedInterrupt {
        /// Its exception number.
        number: u32,
    },
}

/// Memory of one [`Cause`].
///
/// Four words and their checksum; atomics, so that the panic and fault handlers can write them from
/// anywhere.
#[derive(Debug)]
pub struct Record {
    words: [AtomicU32; 4],
}

impl Record {
    /// An empty record.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            words: [const { AtomicU32::new(0) }; 4],
        }
    }

    /// Keeps a cause.
    pub fn set(&self, cause: Cause) {
        let [kind, a, b] = encode(cause);
        for (word, value) in self.words.iter().zip([kind, a, b, checksum(kind, a, b)]) {
            word.store(value, Ordering::Relaxed);
        }
    }

    /// The cause that was kept, if there is a valid one; it is forgotten.
    pub fn take(&self) -> Option<Cause> {
        let [kind, a, b, sum] = [0, 1, 2, 3].map(|at: usize| {
            self.words
                .get(at)
                .map_or(0, |word| word.swap(0, Ordering::Relaxed))
        });
        if sum == checksum(kind, a, b) {
            decode([kind, a, b])
        } else {
            None
        }
    }
}

impl Default for Record {
    fn default() -> Self {
        Self::new()
    }
}

const fn checksum(kind: u32, a: u32, b: u32) -> u32 {
    MAGIC ^ kind ^ a.rotate_left(11) ^ b.rotate_left(22)
}

const fn encode(cause: Cause) -> [u32; 3] {
    match cause {
        Cause::Requested(handover) => [
            1,
            handover.session as u32,
            handover.stay_in_bootloader as u32,
        ],
        Cause::Panic { line, file } => [2, line, file],
        Cause::HardFault { status, address } => [3, status, address],
        Cause::UnexpectedInterrupt { number } => [4, number, 0],
    }
}

const fn decode(words: [u32; 3]) -> Option<Cause> {
    Some(match words {
        [1, session, stay] => Cause::Requested(Handover {
            session: session as u16,
            stay_in_bootloader: stay != 0,
        }),
        [2, line, file] => Cause::Panic { line, file },
        [3, status, address] => Cause::HardFault { status, address },
        [4, number, _] => Cause::UnexpectedInterrupt { number },
        _ => return None,
    })
}

/// FNV-1a of a file's name, to be compared with the names in the sources.
#[must_use]
pub const fn hash(name: &str) -> u32 {
    let bytes = name.as_bytes();
    let mut hash: u32 = 0x811C_9DC5;
    let mut at = 0;
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u32).wrapping_mul(0x0100_0193);
        at += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_is_read_back_once() {
        let record = Record::new();
        assert_eq!(record.take(), None);
        let handover = Handover {
            session: 0xBEEF,
            stay_in_bootloader: true,
        };
        for cause in [
            Cause::Requested(handover),
            Cause::Panic {
                line: 7,
                file: hash("a.rs"),
            },
            Cause::HardFault {
                status: 0x0400,
                address: 0x2000_0000,
            },
            Cause::UnexpectedInterrupt { number: 44 },
        ] {
            record.set(cause);
            assert_eq!(record.take(), Some(cause));
            assert_eq!(record.take(), None);
        }
    }

    #[test]
    fn a_flipped_bit_voids_the_record() {
        let record = Record::new();
        record.set(Cause::Panic { line: 1, file: 2 });
        record.words[1].store(3, Ordering::Relaxed);
        assert_eq!(record.take(), None);
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(hash(""), 0x811C_9DC5);
        assert_eq!(hash("a"), 0xE40C_292C);
    }
}
