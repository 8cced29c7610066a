//! Flash that does not do what it is told: whatever it reports, a save that is reported is in force, and no other.

use super::*;

/// Saves a number; true if that is reported. What is in force afterwards, after a restart too, must be
/// what was reported.
fn save_and_restart(journal: &mut Journal, memory: &mut Memory, number: u8) -> bool {
    let before = Stored::load(journal, memory);
    let stored = Stored {
        number,
        ..Stored::default()
    };
    let saved = journal.save(memory, &stored, true);
    let expected = match saved {
        Ok(Saved { sequence, .. }) => Stored { sequence, ..stored },
        Err(error) => {
            assert_eq!(error, SaveError::Memory);
            before
        }
    };
    let mut restarted = memory.clone();
    let found = Journal::open(&mut restarted);
    assert_eq!(Stored::load(&found, &mut restarted), expected);
    assert_eq!(Stored::load(journal, memory), expected);
    saved.is_ok()
}

#[test]
fn a_place_that_can_not_be_programmed_is_passed_over_also_if_nothing_is_reported() {
    for fault in [Fault::Error, Fault::Silent] {
        for broken in (16..400).step_by(4) {
            let mut memory = Memory::new(2);
            memory.broken = Some((broken, fault));
            let mut journal = Journal::open(&mut memory);
            for number in 1..=5 {
                assert!(save_and_restart(&mut journal, &mut memory, number));
            }
        }
    }
}

#[test]
fn a_save_is_in_force_exactly_if_it_was_reported_whatever_fails() {
    for fault in [Fault::Error, Fault::Silent] {
        for units in [2, 3] {
            for broken in (0..(units * UNIT) as u32).step_by(4) {
                let mut memory = Memory::new(units);
                memory.broken = Some((broken, fault));
                let mut journal = Journal::open(&mut memory);
                // Three rounds of the ring.
                let saved = (1..=60)
                    .filter(|number| save_and_restart(&mut journal, &mut memory, *number))
                    .count();
                // A unit whose header can not be written is waited for, not passed over.
                let is_unit_header = UNIT_HEADER > broken % UNIT as u32;
                assert!(saved == 60 || is_unit_header, "{broken:#x}");
            }
        }
    }
}

#[test]
fn an_erase_that_did_nothing_costs_no_settings() {
    for fault in [Fault::Error, Fault::Silent] {
        for units in [2, 3] {
            for failures in 1..12 {
                let mut memory = Memory::new(units);
                let mut journal = Journal::open(&mut memory);
                let mut failed = 0;
                for number in 1..=60 {
                    if number == 30 {
                        memory.broken_erases = Some((failures, fault));
                    }
                    failed += u32::from(!save_and_restart(&mut journal, &mut memory, number));
                }
                // Each save tries again.
                assert_eq!(
                    failed,
                    failures / WRITE_ATTEMPTS,
                    "{fault:?} {units} {failures}"
                );
            }
        }
    }
}
