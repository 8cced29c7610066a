//! Why the controller restarted: a record in RAM that survives a reset but not a loss of power.

use core::sync::atomic::{AtomicU32, Ordering};

use windlass_core::node::Handover;
use windlass_core::reset::{Crashes, Reset, ResetCause};

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
    /// Failures in a row, for the boot decision.
    pub crashes: Crashes,
}

/// Three words with their checksum; atomics, so that the panic and fault handlers can write them from anywhere.
#[derive(Debug)]
struct Words([AtomicU32; 4]);

impl Words {
    const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; 4])
    }

    #[inline(never)]
    fn put(&self, [a, b, c]: [u32; 3]) {
        // One by one: a loop over them takes twice the code.
        let [first, second, third, sum] = &self.0;
        first.store(a, Ordering::Relaxed);
        second.store(b, Ordering::Relaxed);
        third.store(c, Ordering::Relaxed);
        sum.store(checksum(a, b, c), Ordering::Relaxed);
    }

    fn get(&self) -> Option<[u32; 3]> {
        let [first, second, third, sum] = &self.0;
        let a = first.load(Ordering::Relaxed);
        let b = second.load(Ordering::Relaxed);
        let c = third.load(Ordering::Relaxed);
        (sum.load(Ordering::Relaxed) == checksum(a, b, c)).then_some([a, b, c])
    }

    /// The words, once.
    #[inline(never)]
    fn take(&self) -> Option<[u32; 3]> {
        let words = self.get();
        let [.., sum] = &self.0;
        sum.fetch_xor(MAGIC, Ordering::Relaxed);
        words
    }
}

/// Memory of one [`Cause`], of restarts since power-on and failures in a row, and of what the bootloader passes on.
#[derive(Debug)]
pub struct Record {
    kept: Words,
    counts: Words,
    passed_on: Words,
}

/// What the bootloader tells the application that it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassedOn {
    /// Why the controller has started: the chip and the record tell it only once.
    pub start: Start,
    /// Version of the bootloader.
    pub bootloader_version: u16,
}

/// Bits of the first word beside the code of the cause.
const HAS_HANDOVER: u32 = 1 << 8;
const STAY: u32 = 1 << 9;
const VERSION_SHIFT: u32 = 16;

/// A cause in words; the version is 0 where there is none. A restart with a handover has no detail: the session stands
/// in its place.
const fn encode(reset: &Reset, handover: Option<Handover>, version: u16) -> [u32; 3] {
    let (flags, detail) = match handover {
        None => (0, reset.detail),
        Some(handover) => {
            let stay = if handover.stay_in_bootloader { STAY } else { 0 };
            (HAS_HANDOVER | stay, handover.session as u32)
        }
    };
    let version = (version as u32) << VERSION_SHIFT;
    [reset.cause as u32 | flags | version, detail, reset.place]
}

fn decode([first, detail, place]: [u32; 3]) -> Option<(Reset, Option<Handover>)> {
    let handover = (first & HAS_HANDOVER != 0).then_some(Handover {
        session: detail as u16,
        stay_in_bootloader: first & STAY != 0,
    });
    let reset = Reset {
        cause: ResetCause::from_code(first as u8)?,
        detail: if handover.is_some() { 0 } else { detail },
        place,
        count: 0,
    };
    Some((reset, handover))
}

impl Record {
    /// An empty record.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            kept: Words::new(),
            counts: Words::new(),
            passed_on: Words::new(),
        }
    }

    /// Keeps what the application is to know, which the bootloader starts next.
    pub fn pass_on(&self, passed_on: &PassedOn) {
        let PassedOn {
            start: Start {
                reset, handover, ..
            },
            bootloader_version,
        } = passed_on;
        self.passed_on
            .put(encode(reset, *handover, *bootloader_version));
    }

    /// What the bootloader has passed on, once; none if no bootloader has started this program.
    pub fn take_passed_on(&self) -> Option<PassedOn> {
        let words = self.passed_on.take()?;
        let [first, ..] = words;
        let (reset, handover) = decode(words)?;
        let (count, crashes) = self.counts().unwrap_or_default();
        Some(PassedOn {
            start: Start {
                reset: Reset { count, ..reset },
                handover,
                crashes,
            },
            bootloader_version: (first >> VERSION_SHIFT) as u16,
        })
    }

    /// Keeps a cause.
    pub fn set(&self, cause: Cause) {
        let (reset, handover) = cause.told();
        self.kept.put(encode(&reset, handover, 0));
    }

    /// How this run begins. To be called once for every start, with the cause that the chip tells: it
    /// wins over the record, unless it only says that the program has reset itself.
    pub fn start(&self, hardware: ResetCause) -> Start {
        let kept = self.kept.take().and_then(decode);
        let before = self.counts();
        let powered_off = hardware == ResetCause::PowerOn
            || (hardware == ResetCause::Unknown && before.is_none() && kept.is_none());
        let by_program = matches!(hardware, ResetCause::Requested | ResetCause::Unknown);
        let (mut reset, handover) = match kept {
            Some(told) if by_program => told,
            _ if powered_off => (Reset::POWER_ON, None),
            _ => (Reset::first(hardware), None),
        };
        let mut crashes = Crashes::NONE;
        if let Some((count, before)) = before
            && !powered_off
        {
            reset.count = count.saturating_add(1);
            crashes = before.after(reset.cause);
        }
        self.put_counts(reset.count, crashes);
        Start {
            reset,
            handover,
            crashes,
        }
    }

    /// The program has shown that it works: failures before this count no more.
    pub fn healthy(&self) {
        if let Some((count, _)) = self.counts() {
            self.put_counts(count, Crashes::NONE);
        }
    }

    /// True if memory has been kept since an earlier start: the supply was not off for long.
    #[must_use]
    pub fn survived(&self) -> bool {
        self.counts().is_some()
    }

    /// Restarts since power-on and failures in a row, if the memory was kept.
    fn counts(&self) -> Option<(u32, Crashes)> {
        let [count, crashes, _] = self.counts.get()?;
        Some((count, Crashes(crashes as u8)))
    }

    fn put_counts(&self, count: u32, Crashes(crashes): Crashes) {
        self.counts.put([count, u32::from(crashes), 0]);
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

const fn checksum(a: u32, b: u32, c: u32) -> u32 {
    MAGIC ^ a ^ b.rotate_left(11) ^ c.rotate_left(22)
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
        let nothing = record.start(ResetCause::PowerOn);
        assert_eq!((nothing.reset, nothing.handover), (Reset::POWER_ON, None));
        let handover = Handover {
            session: 0xBEEF,
            stay_in_bootloader: true,
        };
        let [line, file, status, address] = [7, hash("a.rs"), 0x0400, 0x2000_0000];
        for (cause, told, expected) in [
            (
                Cause::Requested(handover),
                (ResetCause::Requested, 0, 0),
                Some(handover),
            ),
            (
                Cause::Panic { line, file },
                (ResetCause::Panic, line, file),
                None,
            ),
            (
                Cause::HardFault { status, address },
                (ResetCause::ProcessorFault, status, address),
                None,
            ),
            (
                Cause::UnexpectedInterrupt { number: 44 },
                (ResetCause::UnexpectedInterrupt, 44, 0),
                None,
            ),
            (Cause::SupplyLow, (ResetCause::BrownOut, 0, 0), None),
            (
                Cause::StackOverflow {
                    status,
                    pointer: 0x1FFF_FFF8,
                },
                (ResetCause::StackGuard, status, 0x1FFF_FFF8),
                None,
            ),
        ] {
            record.set(cause);
            let Start {
                reset, handover, ..
            } = record.start(ResetCause::Requested);
            assert_eq!((reset.cause, reset.detail, reset.place), told);
            assert_eq!(handover, expected);
            let again = record.start(ResetCause::Requested);
            assert_eq!((again.reset.detail, again.handover), (0, None));
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
        let restart = |session, stay_in_bootloader| {
            let handover = Handover {
                session,
                stay_in_bootloader,
            };
            (Reset::first(ResetCause::Requested), Some(handover))
        };
        for (reset, handover) in [(crashed, None), restart(0xFFFF, false), restart(1, true)] {
            let passed_on = PassedOn {
                start: Start {
                    reset,
                    handover,
                    crashes: Crashes::NONE,
                },
                bootloader_version: 0xFF09,
            };
            record.pass_on(&passed_on);
            assert_eq!(record.take_passed_on(), Some(passed_on));
            assert_eq!(record.take_passed_on(), None);
            record.pass_on(&passed_on);
            record.passed_on.0[3].fetch_xor(1, Ordering::Relaxed);
            assert_eq!(record.take_passed_on(), None);
        }
    }

    #[test]
    fn failures_in_a_row_are_counted_until_the_program_works_or_the_power_goes() {
        let record = Record::new();
        let crashes = |hardware| record.start(hardware).crashes;
        assert_eq!(crashes(ResetCause::PowerOn), Crashes::NONE);
        for expected in 1..=3 {
            record.set(PANIC);
            assert_eq!(crashes(ResetCause::Requested), Crashes(expected));
        }
        assert_eq!(crashes(ResetCause::Watchdog), Crashes(4));
        record.healthy();
        assert_eq!(crashes(ResetCause::Watchdog), Crashes(1));
        assert_eq!(crashes(ResetCause::PowerOn), Crashes::NONE);
        assert_eq!(crashes(ResetCause::Watchdog), Crashes(1));
        assert_eq!(crashes(ResetCause::ResetPin), Crashes::NONE);
        // Nothing counts in a memory that has lost what it held, and `healthy` makes nothing valid.
        crashes(ResetCause::Watchdog);
        record.counts.0[1].store(200, Ordering::Relaxed);
        record.healthy();
        assert!(!record.survived());
        assert_eq!(crashes(ResetCause::Watchdog), Crashes::NONE);
    }

    #[test]
    fn a_flipped_bit_voids_the_record() {
        let record = Record::new();
        record.start(ResetCause::PowerOn);
        record.set(Cause::Panic { line: 1, file: 2 });
        record.kept.0[1].store(3, Ordering::Relaxed);
        assert_eq!(
            record.start(ResetCause::Requested).reset.cause,
            ResetCause::Requested
        );
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(hash(""), 0x811C_9DC5);
        assert_eq!(hash("a"), 0xE40C_292C);
    }
}
