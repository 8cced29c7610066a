//! Records, and the decision as a function of two trailers. What whole updates do to flash is tested on the
//! bench's flash model (`tests/`).

extern crate std;

use super::log::Words;
use super::*;

const RECORDS: [Record; 9] = [
    Record::Stored {
        page: 30,
        crc: 0x1234_5678,
    },
    Record::Committed {
        generation: 7,
        image_crc: 0x89AB_CDEF,
    },
    Record::Confirmed,
    Record::TrialFailed,
    Record::UpdateBegun { generation: 8 },
    Record::RestoreBegun { generation: 9 },
    Record::RefreshBegun,
    Record::RefreshEnded { done: true },
    Record::RefreshEnded { done: false },
];

fn log_of(records: &[Record]) -> Log {
    let mut log = Log::EMPTY;
    for record in records {
        log.take(record.words());
    }
    log
}

fn committed(generation: u32, image_crc: u32) -> Record {
    Record::Committed {
        generation,
        image_crc,
    }
}

fn view(application: &[Record], fallback: Option<&[Record]>) -> View {
    View {
        application: log_of(application),
        whole: true,
        fallback: fallback.map(log_of),
    }
}

fn handover(stay_in_bootloader: bool) -> Start {
    Start {
        cause: ResetCause::Requested,
        handover: Some(Handover {
            session: 1,
            stay_in_bootloader,
        }),
        crashes: Crashes::NONE,
    }
}

fn crashed(times: u8) -> Start {
    Start {
        cause: ResetCause::Watchdog,
        handover: None,
        crashes: Crashes(times),
    }
}

#[test]
fn a_record_reads_back_and_none_of_its_bits_may_flip() {
    for record in RECORDS {
        let bytes = record.to_bytes();
        assert_eq!(bytes[..8], RECORD_MARKER);
        let content: [u8; 24] = bytes[8..].try_into().unwrap();
        assert_eq!(Words::from_content(&content), Some(record.words()));
        for bit in 0..24 * 8 {
            let mut flipped = content;
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Words::from_content(&flipped), None, "{record:?} {bit}");
        }
    }
    assert_eq!(Words::from_content(&[0xFF; 24]), None);
    assert_eq!(Words::from_content(&[0; 24]), None);
}

#[test]
fn the_decision_by_what_the_trailers_say() {
    use Decision::{Restore, Stay};
    let failed = [Record::TrialFailed; 3];
    let trial = [&[committed(2, 22)], &failed[..]].concat();
    let confirmed = [&[committed(2, 22), Record::Confirmed], &failed[..]].concat();
    let refreshing = [&[committed(2, 22), Record::RefreshBegun], &failed[..]].concat();
    let other = [committed(1, 11)];
    let same = [committed(1, 22)];
    let updating = [committed(1, 11), Record::UpdateBegun { generation: 3 }];
    let restoring = [committed(1, 11), Record::RestoreBegun { generation: 3 }];
    let restored = [committed(1, 11), Record::RestoreBegun { generation: 2 }];
    for (application, fallback, decision) in [
        (&[][..], None, Stay(Reason::Empty)),
        (&[], Some(&other[..]), Stay(Reason::Empty)),
        (&[RECORDS[0]], None, Stay(Reason::UpdateIncomplete)),
        (&[], Some(&updating), Stay(Reason::UpdateIncomplete)),
        // A commit that is older than what has begun since does not count.
        (&trial[..1], Some(&updating), Stay(Reason::UpdateIncomplete)),
        (&[committed(3, 33)], Some(&updating), Decision::Start),
        (&trial[..1], None, Decision::Start),
        (&trial[..3], Some(&other), Decision::Start),
        (&trial, Some(&other), Restore),
        (&trial, Some(&same), Stay(Reason::TrialFailed)),
        (&trial, None, Stay(Reason::TrialFailed)),
        (&refreshing, Some(&other), Stay(Reason::TrialFailed)),
        (&confirmed, Some(&other), Decision::Start),
        (&[], Some(&restoring), Restore),
        (&trial[..1], Some(&restoring), Restore),
        (&trial[..1], Some(&restored), Decision::Start),
    ] {
        let view = view(application, fallback);
        assert_eq!(
            view.decide(&Start::POWER_ON),
            decision,
            "{application:?} {fallback:?}"
        );
        assert_eq!(view.decide(&handover(true)), Stay(Reason::Requested));
    }
    assert_eq!(
        view(&trial, Some(&other)).decide(&handover(false)),
        Decision::Start
    );
}

#[test]
fn a_confirmed_image_that_fails_eight_times_in_a_row_is_not_started_a_ninth_time() {
    let confirmed = [committed(2, 22), Record::Confirmed];
    let [trial, ..] = confirmed;
    for fallback in [None, Some(&[committed(1, 22)][..])] {
        let view = view(&confirmed, fallback);
        assert_eq!(view.decide(&crashed(CRASH_LIMIT - 1)), Decision::Start);
        for times in [CRASH_LIMIT, u8::MAX] {
            let stays = Decision::Stay(Reason::CrashLoop);
            assert_eq!(view.decide(&crashed(times)), stays);
        }
        // Power and an explicit order try it again.
        assert_eq!(view.decide(&Start::POWER_ON), Decision::Start);
        assert_eq!(view.decide(&handover(false)), Decision::Start);
    }
    // Whatever the flash says comes first: a record in RAM never brings another image.
    let view = view(
        &[trial],
        Some(&[committed(1, 11), Record::RestoreBegun { generation: 3 }]),
    );
    assert_eq!(view.decide(&crashed(CRASH_LIMIT)), Decision::Restore);
}

#[test]
fn a_damaged_image_is_replaced_if_there_is_another_one() {
    let damaged = |fallback| View {
        whole: false,
        ..view(&[committed(2, 22)], fallback)
    };
    assert_eq!(
        damaged(None).decide(&Start::POWER_ON),
        Decision::Stay(Reason::ImageDamaged)
    );
    assert_eq!(
        damaged(Some(&[committed(1, 11)])).decide(&Start::POWER_ON),
        Decision::Restore
    );
}

#[test]
fn the_fallback_is_refreshed_once_after_a_confirmation() {
    let other = [committed(1, 11)];
    for (records, expected) in [
        (&[committed(2, 22)][..], false),
        (&[committed(2, 22), Record::Confirmed], true),
        (
            &[committed(2, 22), Record::Confirmed, Record::RefreshBegun],
            true,
        ),
        (
            &[
                committed(2, 22),
                Record::Confirmed,
                Record::RefreshEnded { done: false },
            ],
            false,
        ),
        (&[committed(2, 11), Record::Confirmed], false),
    ] {
        assert_eq!(view(records, Some(&other)).needs_refresh(), expected);
        assert!(!view(records, None).needs_refresh());
    }
}
