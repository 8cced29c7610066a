//! Sets are found, kept, compared and refused. Cuts have tests of their own on the bench's flash model.

extern crate std;

use std::vec::Vec;

use embedded_storage::nor_flash::{ErrorType, NorFlashErrorKind, ReadNorFlash};

use super::*;
use crate::crc::Crc32;
use crate::engine::snapshot::Faults;
use crate::management::vendor::Descriptor;
use crate::params::Stored;
use crate::params::table::ParameterId;
use crate::reset::{Reset, ResetCause};

const UNIT: usize = 512;

/// How an operation goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// It is reported.
    Error,
    /// Nothing happens, and nothing is reported.
    Silent,
}

/// Memory of a few small units that keeps the rules of flash.
#[derive(Clone)]
struct Memory {
    bytes: Vec<u8>,
    erases: Vec<u32>,
    writes: u32,
    /// Writes to this address fail.
    broken: Option<(u32, Fault)>,
    /// So many erases to come fail.
    broken_erases: Option<(u32, Fault)>,
}

impl Fault {
    const fn result(self) -> Result<(), NorFlashErrorKind> {
        match self {
            Self::Error => Err(NorFlashErrorKind::Other),
            Self::Silent => Ok(()),
        }
    }
}

impl Memory {
    fn new(units: usize) -> Self {
        Self {
            bytes: std::vec![0xFF; units * UNIT],
            erases: std::vec![0; units],
            writes: 0,
            broken: None,
            broken_erases: None,
        }
    }

    fn erased(&self) -> u32 {
        self.erases.iter().sum()
    }
}

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = offset as usize;
        let part = self.bytes.get(from..from + bytes.len());
        bytes.copy_from_slice(part.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = UNIT;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        if let Some((left @ 1.., fault)) = &mut self.broken_erases {
            *left -= 1;
            return fault.result();
        }
        for unit in from as usize / UNIT..to as usize / UNIT {
            self.erases[unit] += 1;
            self.bytes[unit * UNIT..(unit + 1) * UNIT].fill(0xFF);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        if let Some((at, fault)) = self.broken
            && (offset..offset + bytes.len() as u32).contains(&at)
        {
            return fault.result();
        }
        let from = offset as usize;
        let part = &mut self.bytes[from..from + bytes.len()];
        if self.broken_erases.is_some() {
            // As some chips do it: bits become 0, none 1.
            for (byte, new) in part.iter_mut().zip(bytes) {
                *byte &= new;
            }
            return Ok(());
        }
        assert!(
            part.iter().all(|byte| *byte == 0xFF),
            "programmed twice: {offset:#x}"
        );
        part.copy_from_slice(bytes);
        self.writes += 1;
        Ok(())
    }
}

fn settings() -> Stored {
    let mut stored = Stored {
        number: 9,
        sticky: Faults::from_bits(5),
        fault_counts: [1, 0, 255, 3],
        ..Stored::default()
    };
    stored.descriptors.set(Descriptor::DeviceName, &[b'x'; 64]);
    stored.descriptors.set(Descriptor::SerialNumber, b"");
    for (id, value) in [
        (ParameterId::ForwardLimitDisabled, 1),
        (ParameterId::SoftForwardThreshold, -1_i32 as u32),
        (ParameterId::Slot0P, 0x0001_0000),
        // The default is not 0.
        (ParameterId::CurrentLimitP, 0),
        (ParameterId::PeakDuration, 7),
    ] {
        stored.params.set(id, value).unwrap();
    }
    stored
}

fn save(journal: &mut Journal, memory: &mut Memory, stored: &Stored) -> Saved {
    journal.save(memory, stored, true).unwrap()
}

#[test]
fn settings_come_back_as_they_were() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    assert_eq!(Stored::load(&journal, &mut memory), Stored::default());
    assert_eq!(memory.writes, 0, "an empty memory is left alone");
    let saved = save(&mut journal, &mut memory, &settings());
    assert_eq!(
        saved,
        Saved {
            sequence: 1,
            written: true
        }
    );
    let expected = Stored {
        sequence: 1,
        ..settings()
    };
    assert_eq!(Stored::load(&journal, &mut memory), expected);
    let again = Journal::open(&mut memory);
    assert_eq!(Stored::load(&again, &mut memory), expected);
}

#[test]
fn the_latest_crash_is_kept_beside_the_settings_and_the_same_one_is_written_once() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    save(&mut journal, &mut memory, &settings());
    let crashed = |cause| Reset {
        cause,
        detail: 0x8000_0001,
        place: 0xDEAD_BEEF,
        count: 3,
    };
    // A start without a crash keeps nothing.
    for cause in [
        ResetCause::PowerOn,
        ResetCause::Requested,
        ResetCause::BrownOut,
    ] {
        let crash = Crash::keep(&mut journal, &mut memory, &crashed(cause));
        assert_eq!((crash, journal.sequence()), (None, 1));
    }
    for (at, cause) in [ResetCause::Panic, ResetCause::Watchdog]
        .into_iter()
        .enumerate()
    {
        let reset = crashed(cause);
        let expected = Some(Crash {
            cause,
            detail: reset.detail,
            place: reset.place,
        });
        for _ in 0..100 {
            let crash = Crash::keep(&mut journal, &mut memory, &reset);
            assert_eq!((crash, journal.sequence()), (expected, at as u32 + 2));
        }
        // After a loss of power, and with new settings.
        let mut journal = Journal::open(&mut memory);
        let crash = Crash::keep(&mut journal, &mut memory, &Reset::POWER_ON);
        assert_eq!(crash, expected);
    }
    let mut journal = Journal::open(&mut memory);
    assert_eq!(
        Stored::load(&journal, &mut memory).number,
        settings().number
    );
    save(&mut journal, &mut memory, &Stored::default());
    let crash = Crash::keep(&mut journal, &mut memory, &Reset::POWER_ON);
    assert_eq!(crash.map(|crash| crash.cause), Some(ResetCause::Watchdog));
}

#[test]
fn equal_settings_are_not_written_again() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    save(&mut journal, &mut memory, &settings());
    let writes = memory.writes;
    for _ in 0..2 {
        let saved = save(&mut journal, &mut memory, &settings());
        assert_eq!((saved.sequence, saved.written), (1, false));
        journal = Journal::open(&mut memory);
    }
    assert_eq!(memory.writes, writes);
    let mut other = settings();
    other.number = 10;
    assert_eq!(save(&mut journal, &mut memory, &other).sequence, 2);
}

#[test]
fn the_units_are_used_in_turn_and_erased_once_each_round() {
    for units in [2, 3, 5] {
        let mut memory = Memory::new(units);
        let mut journal = Journal::open(&mut memory);
        let mut stored = Stored::default();
        for sequence in 1..=200 {
            stored.number = 1 + (sequence % 63) as u8;
            assert_eq!(save(&mut journal, &mut memory, &stored).sequence, sequence);
            let found = Journal::open(&mut memory);
            assert_eq!(Stored::load(&found, &mut memory).number, stored.number);
            assert_eq!(found.sequence(), sequence);
        }
        let (least, most) = (
            memory.erases.iter().min().unwrap(),
            memory.erases.iter().max().unwrap(),
        );
        assert!(most - least <= 1, "{:?}", memory.erases);
        assert!(*least >= 2);
    }
}

#[test]
fn an_erase_that_is_not_allowed_leaves_the_save_due() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    let stored = settings();
    assert!(journal.wants_erase::<Memory>() && !journal.has_room::<Memory>());
    assert_eq!(
        journal.save(&mut memory, &stored, false),
        Err(SaveError::EraseDue)
    );
    assert_eq!((memory.writes, memory.erased()), (0, 0));
    journal.erase_next(&mut memory).unwrap();
    assert!(!journal.wants_erase::<Memory>() && journal.has_room::<Memory>());
    journal.save(&mut memory, &stored, false).unwrap();
    // The unit in use has room for a few more sets, the next one is not ready.
    assert!(journal.wants_erase::<Memory>());
    let mut refused = false;
    for number in 1..=20 {
        let stored = Stored {
            number,
            ..settings()
        };
        match journal.save(&mut memory, &stored, false) {
            Ok(_) => assert_eq!(Stored::load(&journal, &mut memory).number, number),
            Err(error) => {
                assert_eq!(error, SaveError::EraseDue);
                refused = true;
            }
        }
    }
    assert!(refused && memory.erased() == 1);
}

#[test]
fn entries_of_others_are_kept_and_can_be_changed_alone() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    let key = Key::Other(0x40);
    // A parameter that only a later firmware knows.
    let unknown = Key::Parameter(254);
    for (key, value) in [(key, &[7; 64][..]), (unknown, &[1, 2])] {
        let change = Change {
            key,
            value: Some(value),
        };
        journal.save(&mut memory, &change, true).unwrap();
    }
    for _ in 0..10 {
        save(&mut journal, &mut memory, &settings());
        save(&mut journal, &mut memory, &Stored::default());
    }
    assert_eq!(journal.get(&mut memory, key).unwrap(), [7; 64]);
    assert_eq!(journal.get(&mut memory, unknown).unwrap(), [1, 2]);
    save(&mut journal, &mut memory, &settings());
    let number = Change {
        key: Key::NUMBER,
        value: Some(&[33]),
    };
    journal.save(&mut memory, &number, true).unwrap();
    let removed = Change { key, value: None };
    journal.save(&mut memory, &removed, true).unwrap();
    let journal = Journal::open(&mut memory);
    assert_eq!(journal.get(&mut memory, key), None);
    assert_eq!(
        Stored::load(&journal, &mut memory),
        Stored {
            number: 33,
            sequence: journal.sequence(),
            ..settings()
        }
    );
}

#[test]
fn values_that_are_not_allowed_leave_the_defaults() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    let wrong: [(Key, &[u8]); 8] = [
        (Key::NUMBER, &[64]),
        (Key::NUMBER, &[]),
        (Key::FAULT_COUNTS, &[1; 5]),
        (Key::Parameter(17), &[0xFF, 0xFF]),
        (Key::Parameter(10), &[1; 5]),
        // Volatile, and live.
        (Key::Parameter(93), &[20]),
        (Key::Parameter(41), &[1]),
        (Key::Other(99), &[0; 64]),
    ];
    for (key, value) in wrong {
        let change = Change {
            key,
            value: Some(value),
        };
        journal.save(&mut memory, &change, true).unwrap();
    }
    let stored = Stored {
        sequence: 0,
        ..Stored::load(&journal, &mut memory)
    };
    assert_eq!(stored, Stored::default());
}

/// Turns the newest set of a memory into one of the next format, as a later firmware would write it.
fn reformat(memory: &mut Memory, journal: &Journal) {
    let mut set = journal.newest.unwrap();
    set.format = FORMAT + 1;
    let mut crc = Crc32::new();
    let from = set.entries() as usize;
    crc.update(&memory.bytes[from..from + usize::from(set.length)]);
    set.crc = set.finish_crc(crc);
    let at = set.address as usize;
    memory.bytes[at + 8..at + 24].fill(0xFF);
    set.write_header(memory).unwrap();
}

#[test]
fn a_newer_format_is_neither_read_nor_destroyed() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    save(&mut journal, &mut memory, &Stored::default());
    save(&mut journal, &mut memory, &settings());
    reformat(&mut memory, &journal);
    let before = memory.bytes.clone();
    let mut journal = Journal::open(&mut memory);
    assert!(journal.is_newer_format() && !journal.wants_erase::<Memory>());
    assert_eq!(journal.entries(&mut memory).count(), 0);
    assert_eq!(
        Stored::load(&journal, &mut memory).params,
        Stored::default().params
    );
    for may_erase in [false, true] {
        assert_eq!(
            journal.save(&mut memory, &settings(), may_erase),
            Err(SaveError::NewerFormat)
        );
    }
    assert_eq!(journal.erase_next(&mut memory), Err(SaveError::NewerFormat));
    assert_eq!(memory.bytes, before);
}

#[test]
fn what_does_not_fit_is_refused_and_the_set_before_stays() {
    let mut memory = Memory::new(2);
    let mut journal = Journal::open(&mut memory);
    save(&mut journal, &mut memory, &settings());
    let mut result = Ok(());
    for id in 0x40..0x60 {
        let change = Change {
            key: Key::Other(id),
            value: Some(&[1; 64]),
        };
        result = journal.save(&mut memory, &change, true).map(|_| ());
    }
    assert_eq!(result, Err(SaveError::TooLarge));
    let journal = Journal::open(&mut memory);
    assert_eq!(Stored::load(&journal, &mut memory).number, 9);
    // One unit makes no journal.
    let mut single = Memory::new(1);
    let mut journal = Journal::open(&mut single);
    assert!(!journal.wants_erase::<Memory>());
    assert_eq!(
        journal.save(&mut single, &settings(), true),
        Err(SaveError::TooLarge)
    );
    assert_eq!(journal.erase_next(&mut single), Err(SaveError::TooLarge));
    assert_eq!(single.erased(), 0);
}

#[test]
fn the_largest_set_fits_every_geometry() {
    // Every persistent parameter away from its default and not compressible, every string full.
    let parameters = crate::params::table::COUNT * (2 + 4);
    let texts: usize = Descriptor::ALL
        .iter()
        .map(|which| 2 + which.capacity())
        .sum();
    let faults_and_number = 3 + 3 + 6;
    // Keys, counters and the like of a bootloader.
    let reserve = 256;
    let entries = (parameters + texts + faults_and_number + reserve) as u16;
    // One page of 2 KiB, half a sector of 16 KiB.
    assert!(Set::extent_of(entries) <= 2048 - UNIT_HEADER);
    assert!(Set::extent_of(entries) <= (16 * 1024 - UNIT_HEADER) / 2);
}

mod failures;

mod properties {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn anything_in_flash_loads_something_allowed(
            noise in proptest::collection::vec(any::<u8>(), 2 * UNIT),
            edits in proptest::collection::vec((0..2 * UNIT, any::<u8>()), 0..20),
            saves in 0..12_u8,
        ) {
            // Noise, and a journal with a few bytes changed.
            let mut edited = Memory::new(2);
            let mut journal = Journal::open(&mut edited);
            for number in 1..=saves {
                save(&mut journal, &mut edited, &Stored { number, ..settings() });
            }
            for (at, value) in edits {
                edited.bytes[at] = value;
            }
            for bytes in [noise, edited.bytes] {
                let mut memory = Memory { bytes, ..Memory::new(2) };
                // Recovery may find cells that are not erased where it reads them so; none here.
                let mut journal = Journal::open(&mut memory);
                let stored = Stored::load(&journal, &mut memory);
                prop_assert!(stored.number <= 63);
                for row in &crate::params::table::TABLE {
                    prop_assert!(row.kind.allows(stored.params.get(row.id)));
                }
                save(&mut journal, &mut memory, &settings());
                let found = Journal::open(&mut memory);
                prop_assert_eq!(Stored::load(&found, &mut memory).params, settings().params);
            }
        }
    }
}
