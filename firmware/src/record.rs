//! Why the controller restarted: a record in RAM that survives a reset but not a loss of power.

use core::sync::atomic::{AtomicU32, Ordering};

use windlass_core::node::Handover;
use windlass_core::reset::{Reset, ResetCause};

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
        /// Address of the instruction.
        address: u32,
    },
    /// An interrupt came that nothing handles.
    UnexpectedInterrupt {
        /// Its exception number.
        number: u32,
    },
    /// The supply of the chip has fallen below the detector's threshold.
    SupplyLow,
    /// A fault of the processor with the stack pointer beyond the end of the stack.
    StackOverflow {
        /// Configurable Fault Status Register.
        status: u32,
        /// Stack pointer.
        pointer: u32,
    },
}

/// How a run begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// For the node.
    pub reset: Reset,
    /// Left by the run before, if it restarted on purpose.
    pub handover: Option<Handover>,
}

/// Memory of one [`Cause`] and of the number of restarts since power-on.
///
/// Words with their checksums; atomics, so that the panic and fault handlers can write them from anywhere.
#[derive(Debug)]
pub struct Record {
    words: [AtomicU32; 4],
    count: [AtomicU32; 2],
    passed_on: [AtomicU32; 5],
}

/// What the bootloader tells the application that it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassedOn {
    /// Why the controller has started: the chip and the record tell it only once.
    pub start: Start,
    /// Version of the bootloader.
    pub bootloader_version: u16,
}

/// Bits of the first word that is passed on.
const HAS_HANDOVER: u32 = 1 << 8;
const STAY: u32 = 1 << 9;
const VERSION_SHIFT: u32 = 16;

impl Record {
    /// An empty record.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            words: [const { AtomicU32::new(0) }; 4],
            count: [const { AtomicU32::new(0) }; 2],
            passed_on: [const { AtomicU32::new(0) }; 5],
        }
    }

    /// Keeps what the application is to know, which the bootloader starts next.
    pub fn pass_on(&self, passed_on: &PassedOn) {
        let PassedOn {
            start: Start { reset, handover },
            bootloader_version,
        } = passed_on;
        let (session, flags) = match handover {
            None => (0, 0),
            Some(handover) if handover.stay_in_bootloader => {
                (handover.session, HAS_HANDOVER | STAY)
            }
            Some(handover) => (handover.session, HAS_HANDOVER),
        };
        let first = reset.cause as u32 | flags | u32::from(*bootloader_version) << VERSION_SHIFT;
        let session = u32::from(session);
        let (detail, place) = (reset.detail, reset.place);
        let sum = checksum(first, detail, place) ^ session;
        let words = [first, detail, place, session, sum];
        for (word, value) in self.passed_on.iter().zip(words) {
            word.store(value, Ordering::Relaxed);
        }
    }

    /// What the bootloader has passed on, once; none if no bootloader has started this program.
    pub fn take_passed_on(&self) -> Option<PassedOn> {
        let [first, detail, place, session, sum] = [0, 1, 2, 3, 4].map(|at: usize| {
            self.passed_on
                .get(at)
                .map_or(0, |word| word.swap(0, Ordering::Relaxed))
        });
        if sum != checksum(first, detail, place) ^ session {
            return None;
        }
        Some(PassedOn {
            start: Start {
                reset: Reset {
                    cause: ResetCause::from_code(first as u8)?,
                    detail,
                    place,
                    count: self.count().unwrap_or(0),
                },
                handover: (first & HAS_HANDOVER != 0).then_some(Handover {
                    session: session as u16,
                    stay_in_bootloader: first & STAY != 0,
                }),
            },
            bootloader_version: (first >> VERSION_SHIFT) as u16,
        })
    }

    /// Keeps a cause.
    pub fn set(&self, cause: Cause) {
        let [kind, a, b] = encode(cause);
        for (word, value) in self.words.iter().zip([kind, a, b, checksum(kind, a, b)]) {
            word.store(value, Ordering::Relaxed);
        }
    }

    /// How this run begins. To be called once for every start, with the cause that the chip tells: it
    /// wins over the record, unless it only says that the program has reset itself.
    pub fn start(&self, hardware: ResetCause) -> Start {
        let kept = self.take();
        let before = self.count();
        let powered_off = matches!(hardware, ResetCause::PowerOn)
            || (hardware == ResetCause::Unknown && before.is_none() && kept.is_none());
        let count = match before {
            Some(count) if !powered_off => count.saturating_add(1),
            _ => 0,
        };
        self.set_count(count);
        let by_program = matches!(hardware, ResetCause::Requested | ResetCause::Unknown);
        let (reset, handover) = match kept {
            Some(cause) if by_program => cause.told(),
            _ if powered_off => (Reset::POWER_ON, None),
            _ => (Reset::first(hardware), None),
        };
        Start {
            reset: Reset { count, ..reset },
            handover,
        }
    }

    /// True if memory has been kept since an earlier start: the supply was not off for long.
    #[must_use]
    pub fn survived(&self) -> bool {
        self.count().is_some()
    }

    /// Restarts since power-on, if the memory was kept.
    fn count(&self) -> Option<u32> {
        let [count, sum] = &self.count;
        let count = count.load(Ordering::Relaxed);
        (sum.load(Ordering::Relaxed) == checksum(count, 0, 0)).then_some(count)
    }

    fn set_count(&self, value: u32) {
        let [count, sum] = &self.count;
        count.store(value, Ordering::Relaxed);
        sum.store(checksum(value, 0, 0), Ordering::Relaxed);
    }

    /// The cause that was kept, if there is a valid one; it is forgotten.
    fn take(&self) -> Option<Cause> {
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

impl Cause {
    /// What the node tells of it, without the count, and the handover.
    const fn told(self) -> (Reset, Option<Handover>) {
        let (cause, detail, place) = match self {
            Self::Requested(handover) => {
                return (Reset::first(ResetCause::Requested), Some(handover));
            }
            Self::SupplyLow => (ResetCause::BrownOut, 0, 0),
            Self::Panic { line, file } => (ResetCause::Panic, line, file),
            Self::HardFault { status, address } => (ResetCause::ProcessorFault, status, address),
            Self::UnexpectedInterrupt { number } => (ResetCause::UnexpectedInterrupt, number, 0),
            Self::StackOverflow { status, pointer } => (ResetCause::StackGuard, status, pointer),
        };
        let reset = Reset {
            cause,
            detail,
            place,
            count: 0,
        };
        (reset, None)
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
        Cause::StackOverflow { status, pointer } => [5, status, pointer],
        Cause::SupplyLow => [6, 0, 0],
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
        [5, status, pointer] => Cause::StackOverflow { status, pointer },
        [6, ..] => Cause::SupplyLow,
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
            Cause::SupplyLow,
            Cause::StackOverflow {
                status: 0x1000,
                pointer: 0x1FFF_FFF8,
            },
        ] {
            record.set(cause);
            assert_eq!(record.take(), Some(cause));
            assert_eq!(record.take(), None);
        }
    }

    const PANIC: Cause = Cause::Panic { line: 7, file: 9 };

    fn started(record: &Record, hardware: ResetCause) -> (ResetCause, u32, u32, u32) {
        let Start { reset, .. } = record.start(hardware);
        (reset.cause, reset.detail, reset.place, reset.count)
    }

    #[test]
    fn a_start_tells_what_the_program_has_left_if_the_chip_says_that_it_reset_itself() {
        let record = Record::new();
        let power_on = (ResetCause::PowerOn, 0, 0, 0);
        assert_eq!(started(&record, ResetCause::PowerOn), power_on);
        record.set(PANIC);
        let panic = (ResetCause::Panic, 7, 9, 1);
        assert_eq!(started(&record, ResetCause::Requested), panic);
        // Told once; a debug probe resets in the same way and leaves nothing.
        let requested = (ResetCause::Requested, 0, 0, 2);
        assert_eq!(started(&record, ResetCause::Requested), requested);
    }

    #[test]
    fn what_the_chip_says_wins_over_a_record_and_power_on_starts_the_count_anew() {
        let record = Record::new();
        record.start(ResetCause::PowerOn);
        for (hardware, count) in [
            (ResetCause::Watchdog, 1),
            (ResetCause::ResetPin, 2),
            (ResetCause::BrownOut, 3),
            (ResetCause::PowerOn, 0),
        ] {
            record.set(PANIC);
            assert_eq!(started(&record, hardware), (hardware, 0, 0, count));
        }
    }

    #[test]
    fn without_flags_of_the_chip_the_record_decides() {
        let record = Record::new();
        assert_eq!(started(&record, ResetCause::Unknown).0, ResetCause::PowerOn);
        record.set(PANIC);
        assert_eq!(
            started(&record, ResetCause::Unknown),
            (ResetCause::Panic, 7, 9, 1)
        );
        assert_eq!(
            started(&record, ResetCause::Unknown),
            (ResetCause::Unknown, 0, 0, 2)
        );
    }

    #[test]
    fn only_a_restart_on_purpose_hands_over() {
        let record = Record::new();
        let handover = Handover {
            session: 7,
            stay_in_bootloader: false,
        };
        record.set(Cause::Requested(handover));
        let start = record.start(ResetCause::Requested);
        assert_eq!(
            (start.reset.cause, start.handover),
            (ResetCause::Requested, Some(handover))
        );
        // A watchdog between the order and the restart voids the session.
        record.set(Cause::Requested(handover));
        assert_eq!(record.start(ResetCause::Watchdog).handover, None);
    }

    #[test]
    fn what_the_bootloader_passes_on_is_read_once_and_whole() {
        let record = Record::new();
        assert_eq!(record.take_passed_on(), None);
        record.start(ResetCause::PowerOn);
        let crashed = Reset {
            cause: ResetCause::Panic,
            detail: 7,
            place: 0xFFFF_FFFF,
            count: 0,
        };
        for handover in [
            None,
            Some(Handover {
                session: 0xFFFF,
                stay_in_bootloader: false,
            }),
            Some(Handover {
                session: 1,
                stay_in_bootloader: true,
            }),
        ] {
            let passed_on = PassedOn {
                start: Start {
                    reset: crashed,
                    handover,
                },
                bootloader_version: 0xFF09,
            };
            record.pass_on(&passed_on);
            assert_eq!(record.take_passed_on(), Some(passed_on));
            assert_eq!(record.take_passed_on(), None);
            record.pass_on(&passed_on);
            record.passed_on[3].fetch_xor(1, Ordering::Relaxed);
            assert_eq!(record.take_passed_on(), None);
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
