//! Parameters, identity and faults: what a node keeps.

use std::vec::Vec;

use super::*;
use crate::reset::HEALTHY_AFTER;
use crate::time::TICK;

#[test]
fn every_parameter_reads_its_default_and_unknown_ones_are_refused() {
    let mut bench = Bench::connected();
    for code in 0..=255 {
        let response = bench.get(code);
        assert_eq!(response.parameter, code);
        match ParameterId::from_code(code) {
            Some(id) => {
                let expected = match id {
                    // The table holds no default for what is computed; the bench was switched on.
                    ParameterId::ResetCause => crate::reset::ResetCause::PowerOn as u32,
                    ParameterId::Leds => bench.node.leds(bench.now, &bench.snapshot).to_bits(),
                    _ => id.row().default,
                };
                assert_eq!((response.value, response.code), (expected, 0), "{code}");
            }
            None => assert_eq!((response.value, response.code), (0, 1), "{code}"),
        }
    }
    let refused = bench.set(37, 1);
    assert_eq!((refused.value, refused.code), (0, 1));
    let bad = bench.set(17, 40_000);
    assert_eq!((bad.value, bad.code), (0, 2));
    assert_eq!(bench.get(17).value, 32767);
}

#[test]
fn every_parameter_can_be_asked_for_in_one_burst() {
    let mut bench = Bench::connected();
    let session = bench.session();
    bench.sent.clear();
    for row in &crate::params::table::TABLE {
        let request = ParameterRequest {
            session,
            parameter: row.id.code(),
        };
        bench
            .node
            .on_frame(bench.now, &request.emit(5), &bench.snapshot);
    }
    bench.flush();
    let answers: Vec<_> = bench
        .sent
        .iter()
        .filter_map(|(_, frame)| ParameterResponse::parse(frame))
        .map(|response| response.parameter)
        .collect();
    assert_eq!(
        answers,
        crate::params::table::TABLE.map(|row| row.id.code())
    );
    assert_eq!(bench.node.counters().answers_lost, 0);
}

#[test]
fn a_parameter_acts_at_once_and_is_saved_by_the_15_s_rule() {
    let mut bench = Bench::connected();
    assert_eq!(bench.set(16, 1000).value, 1000);
    bench.run(1);
    assert_eq!(bench.actions, [Action::Save]);
    bench.set(16, 1001);
    bench.run(29_999);
    assert_eq!(bench.actions.len(), 1);
    bench.run(2);
    assert_eq!(bench.actions.len(), 2);
    bench.set(16, 1001);
    bench.run(40_000);
    assert_eq!(bench.actions.len(), 2, "an unchanged value writes nothing");
    bench.set(93, 20);
    bench.run(40_000);
    assert_eq!(
        bench.actions.len(),
        2,
        "a volatile parameter writes nothing"
    );
}

#[test]
fn stored_settings_come_back_and_volatile_ones_do_not() {
    let mut bench = Bench::connected();
    bench.set(10, 0x5_0000);
    bench.set(93, 20);
    bench.vendor(0x01, 9);
    let stored = bench.node.stored();
    let mut again = Bench::with(&NodeConfig::dmc60c(1), Some(stored));
    again.run(10);
    again.receive(&Frame::extended(0, []));
    assert_eq!(again.node.number(), 9);
    assert_eq!(again.get(10).value, 0x5_0000);
    assert_eq!(again.get(93).value, 10);
}

#[test]
fn a_new_number_answers_under_itself_and_a_refused_one_under_the_old() {
    let mut bench = Bench::connected();
    let status = bench.vendor(0x01, 17).unwrap();
    assert_eq!(
        status,
        VendorStatus {
            code: 0,
            byte_count: 0
        }
    );
    assert_eq!(bench.sent[0].1.extended_id(), Some(id::VENDOR_STATUS | 17));
    assert_eq!(bench.actions, [Action::Save]);
    assert_eq!(
        bench.vendor(0x01, 64).unwrap().code,
        CommandCode::BadParameter as u16
    );
    assert_eq!(bench.sent[0].1.extended_id(), Some(id::VENDOR_STATUS | 17));
}

#[test]
fn sticky_faults_and_counts_are_read_then_cleared_independently() {
    let mut bench = Bench::connected();
    bench.sample.pins.set(Pin::GateDriverFault, true);
    bench.run(1);
    bench.sample.pins.set(Pin::GateDriverFault, false);
    bench.run(1);
    assert_eq!(
        (
            bench.get(51).value,
            bench.get(52).value,
            bench.get(56).value
        ),
        (8, 8, 1)
    );
    assert_eq!(bench.set(51, 1).value, 8, "active faults cannot be written");
    assert_eq!(bench.set(52, 0).value, 8);
    assert_eq!(bench.set(52, 1).value, 8, "the value before clearing");
    assert_eq!(bench.get(52).value, 0);
    assert_eq!(bench.get(56).value, 1, "the count stays");
    assert_eq!((bench.set(56, 7).value, bench.get(56).value), (1, 0));
    bench.run(6000);
    assert_eq!(bench.get(51).value, 0);
}

#[test]
fn the_button_toggles_the_stored_neutral_setting() {
    let mut bench = Bench::connected();
    assert_eq!(bench.get(129).value, 1);
    bench.node.press_button(bench.now);
    bench.run(1);
    assert_eq!(bench.get(129).value, 0);
    assert_eq!(
        bench.snapshot.neutral,
        crate::engine::command::Neutral::Coast
    );
}

#[test]
fn strings_are_stored_at_once() {
    let mut bench = Bench::connected();
    bench.vendor(0x02, 6);
    let data = Frame::extended(id::VENDOR_DATA_OUT | 5, *b"winch\0");
    bench.receive(&data);
    assert_eq!(
        bench
            .node
            .stored()
            .descriptors
            .stored(Descriptor::DeviceName),
        Some(&b"winch"[..])
    );
    assert_eq!(bench.actions, [Action::Save]);
    assert_eq!(
        bench.node.stored().sequence,
        2,
        "one write so far, the next one is the second"
    );
}

#[test]
fn the_flash_sequence_number_counts_writes() {
    let mut bench = Bench::connected();
    bench.vendor(0x01, 6);
    bench.vendor(0x01, 5);
    assert_eq!(bench.vendor(0x62, 0).unwrap().byte_count, 4);
    assert_eq!(bench.sent[1].1.data(), [2, 0, 0, 0]);
}

#[test]
fn the_first_answer_that_is_sent_confirms_the_image_once() {
    let mut bench = Bench::connected();
    bench.run(1_000);
    assert_eq!(bench.confirmations, 0, "status frames are no answers");
    bench.get(16);
    bench.run(1);
    assert_eq!(bench.confirmations, 1);
    bench.get(16);
    bench.run(1);
    assert_eq!(bench.confirmations, 1);
}

#[test]
fn a_node_calls_itself_healthy_after_ten_seconds_or_with_its_first_answer() {
    let mut bench = Bench::connected();
    let end = Instant::ZERO + HEALTHY_AFTER;
    while bench.now + TICK < end {
        bench.run(1);
    }
    assert_eq!(bench.healthy, 0);
    bench.run(2 + 40_000);
    assert_eq!(
        (bench.healthy, bench.confirmations),
        (1, 0),
        "once, by time"
    );
}
