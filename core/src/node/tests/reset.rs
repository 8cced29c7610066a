//! How the node started and what it has lost, as its own parameters tell it.

use super::*;
use crate::params::journal::Crash;
use crate::reset::{Reset, ResetCause};

/// Cause, detail, place and count as they are read over the bus.
fn read(bench: &mut Bench) -> [u32; 4] {
    [130, 132, 135, 134].map(|parameter| {
        let answer = bench.get(parameter);
        assert_eq!(answer.code, 0, "{parameter}");
        answer.value
    })
}

#[test]
fn the_reset_s_cause_detail_place_and_count_are_read_over_the_bus() {
    for (cause, _) in ResetCause::TABLE {
        let reset = Reset {
            cause: *cause,
            detail: 0x8000_0001,
            place: 0xDEAD_BEEF,
            count: 7,
        };
        let crash = Crash {
            cause: *cause,
            detail: 0x8000_0002,
            place: 0xBEEF_DEAD,
        };
        let config = NodeConfig {
            reset,
            crash: Some(crash),
            ..NodeConfig::dmc60c(1)
        };
        let mut bench = Bench::with(&config, None);
        bench.receive(&Frame::extended(0x1FFF_FFFF, []));
        let expected = [*cause as u32, 0x8000_0001, 0xDEAD_BEEF, 7];
        assert_eq!(read(&mut bench), expected);
        let crash = [153, 154, 155].map(|parameter| bench.get(parameter).value);
        assert_eq!(crash, [*cause as u32, 0x8000_0002, 0xBEEF_DEAD]);
        // Writing is answered and changes nothing.
        for parameter in [130, 132, 133, 134, 135, 136, 153, 154, 155] {
            let before = bench.get(parameter).value;
            let answer = bench.set(parameter, 1234);
            assert_eq!((answer.code, answer.value), (0, before));
        }
        assert_eq!(read(&mut bench), expected);
    }
}

#[test]
fn frames_that_were_lost_are_read_over_the_bus() {
    let mut bench = Bench::connected();
    assert_eq!((bench.get(133).value, bench.get(136).value), (0, 0));
    bench.node.set_dropped(12);
    bench.now = bench.now + Duration::from_millis(10);
    let transmission = bench
        .node
        .poll_tx(bench.now, &bench.snapshot)
        .expect("a status frame is due");
    bench
        .node
        .on_transmitted(bench.now, transmission.tag, TxOutcome::Failed);
    assert_eq!((bench.get(133).value, bench.get(136).value), (12, 1));
}
