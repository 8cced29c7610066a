//! Talon SRX: status frames, faults, settings memory. The numbers are the rows of docs/talon-srx-rows.md.

use windlass::client::talon::{ControlMode, StatusFrame, fault};
use windlass_core::dialect::talon_srx::wire::{Parameter, ParameterRequest, Status5, TABLE, id};
use windlass_sim::{Poke, TraceEntry};
use windlass_tests::talon::TalonBench;

/// Gaps between frames in µs.
fn gaps(frames: &[TraceEntry]) -> Vec<u64> {
    let times: Vec<u64> = frames.iter().map(|entry| entry.at.as_micros()).collect();
    times.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

#[test]
fn row_94_the_four_status_frames_have_their_default_periods() {
    for enabled in [false, true] {
        let bench = TalonBench::new(&["talon:3"]);
        let _talon = bench.talon(3);
        if enabled {
            bench.robot.enable().unwrap();
        }
        let from = bench.next_frame();
        bench.run(5000);
        for (id, period_ms) in [
            (id::STATUS_1, 10),
            (id::STATUS_2, 20),
            (id::STATUS_3, 100),
            (id::STATUS_4, 100),
        ] {
            let frames = bench.frames(from, id, 3);
            assert!(frames.len().abs_diff(5000 / period_ms) <= 1, "{id:#x}");
            for gap in gaps(&frames) {
                assert!(
                    gap.abs_diff(period_ms as u64 * 1000) <= 1000,
                    "{id:#x}: {gap} µs"
                );
            }
            assert!(frames.iter().all(|entry| entry.frame.dlc() == 8));
        }
        for id in [id::STATUS_5, id::STATUS_6, id::STATUS_7] {
            assert!(bench.frames(from, id, 3).is_empty());
        }
    }
}

#[test]
fn row_95_every_period_from_1_to_255_ms_can_be_set_and_the_others_stay() {
    let (bench, talon) = TalonBench::enabled();
    let frames = [
        (StatusFrame::General, id::STATUS_1, 10),
        (StatusFrame::Feedback, id::STATUS_2, 20),
        (StatusFrame::QuadEncoder, id::STATUS_3, 100),
        (StatusFrame::AnalogTempVbat, id::STATUS_4, 100),
    ];
    for (frame, own, default) in frames {
        for period in [1_u8, 7, 255] {
            talon.set_status_frame_rate_ms(frame, period).unwrap();
            bench.run(300);
            let from = bench.next_frame();
            bench.run(2550);
            for (_, id, usual) in frames {
                let expected = if id == own {
                    usize::from(period)
                } else {
                    usual
                };
                let count = bench.frames(from, id, 3).len();
                let wanted = 2550 / expected;
                assert!(
                    count.abs_diff(wanted) <= 1 + wanted / 100,
                    "{id:#x} {count} {wanted}"
                );
            }
        }
        talon
            .set_status_frame_rate_ms(frame, default as u8)
            .unwrap();
    }
    // The device forgets them with its power.
    talon
        .set_status_frame_rate_ms(StatusFrame::General, 50)
        .unwrap();
    bench.run(100);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    let from = bench.next_frame();
    bench.run(1000);
    assert!(bench.frames(from, id::STATUS_1, 3).len().abs_diff(100) <= 1);
}

#[test]
fn row_94_a_start_up_frame_comes_once_after_a_reset() {
    let (bench, talon) = TalonBench::enabled();
    let from = bench.next_frame();
    bench.world(|world| world.power_cycle(0));
    bench.run(1000);
    let frames = bench.frames(from, id::STATUS_5, 3);
    let [only] = frames.as_slice() else {
        panic!("one start-up frame: {frames:?}");
    };
    let start_up = Status5::parse(&only.frame).unwrap();
    assert_eq!(talon.start_up(), Some(start_up));
    let [major, minor] = start_up.version;
    assert_eq!(talon.firmware_version().unwrap(), (major, minor));
    assert!((major, minor) >= (1, 1) && (major, minor) != (255, 255));
}

#[test]
fn row_34_status_comes_unsolicited_in_every_mode() {
    // Nobody else has said anything: a disabled robot sends nothing.
    let silent = TalonBench::new(&["talon:3"]);
    silent.run(700);
    for (id, count) in [(id::STATUS_1, 99), (id::STATUS_2, 49), (id::STATUS_4, 9)] {
        let seen = silent.frames(0, id, 3).len();
        assert!(seen.abs_diff(count) <= 2, "{id:#x}: {seen}");
    }
    let (bench, talon) = TalonBench::enabled();
    for mode in [
        ControlMode::PercentVbus,
        ControlMode::Position,
        ControlMode::Speed,
        ControlMode::Follower,
        ControlMode::Voltage,
    ] {
        talon.set_control_mode(mode).unwrap();
        talon.set(0.0).unwrap();
        let from = bench.next_frame();
        bench.run(1000);
        for (id, count) in [
            (id::STATUS_1, 100),
            (id::STATUS_2, 50),
            (id::STATUS_3, 10),
            (id::STATUS_4, 10),
        ] {
            let seen = bench.frames(from, id, 3).len();
            assert!(seen.abs_diff(count) <= 1, "{mode:?} {id:#x}: {seen}");
        }
    }
}

#[test]
fn row_35_measurements_agree_with_the_plant() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::BatteryVolts(Some(11.0)));
    bench.poke(0, Poke::TemperatureCelsius(Some(61.0)));
    bench.poke(0, Poke::LoadNewtonMetres(0.3));
    talon.set(0.5).unwrap();
    bench.run(3000);
    let truth = bench.truth(0);
    let near = |value: f64, wanted: f64, tolerance: f64| (value - wanted).abs() <= tolerance;
    assert!(near(talon.bus_voltage().fresh().unwrap(), truth.bus_v, 0.1));
    assert!(near(
        talon.temperature().fresh().unwrap(),
        truth.temp_c,
        1.5
    ));
    let current = talon.output_current().fresh().unwrap();
    assert!(
        near(current, truth.current_a.abs(), 0.3 + truth.current_a * 0.05),
        "{current} {truth:?}"
    );
    let output = talon.output_voltage().fresh().unwrap();
    assert!(near(output, truth.bus_v * 0.5, 0.1), "{output}");
}

#[test]
fn row_62_row_98_six_faults_are_live_and_sticky_and_only_limits_stop_the_drive() {
    let cases: [(Poke, Poke, u16, bool); 4] = [
        (
            Poke::BatteryVolts(Some(6.0)),
            Poke::BatteryVolts(Some(12.0)),
            fault::BUS_VOLTAGE,
            false,
        ),
        (
            Poke::TemperatureCelsius(Some(105.0)),
            Poke::TemperatureCelsius(Some(25.0)),
            fault::TEMPERATURE,
            false,
        ),
        (
            Poke::ForwardLimitClosed(true),
            Poke::ForwardLimitClosed(false),
            fault::FORWARD_LIMIT_SWITCH,
            true,
        ),
        (
            Poke::ReverseLimitClosed(true),
            Poke::ReverseLimitClosed(false),
            fault::REVERSE_LIMIT_SWITCH,
            false,
        ),
    ];
    for (cause, end, bit, stops) in cases {
        let (bench, talon) = TalonBench::enabled();
        talon.set(0.1).unwrap();
        bench.run(300);
        assert!(talon.faults().fresh().unwrap().is_empty());
        bench.poke(0, cause);
        bench.run(300);
        assert_eq!(talon.faults().fresh().unwrap().0, bit);
        assert_eq!(talon.sticky_faults().fresh().unwrap().0, bit);
        assert_eq!(
            bench.throttle(0),
            if stops { 0 } else { 102 },
            "fault {bit:#x}"
        );
        bench.poke(0, end);
        bench.run(300);
        assert_eq!(talon.faults().fresh().unwrap().0, 0);
        assert_eq!(
            talon.sticky_faults().fresh().unwrap().0,
            bit,
            "sticky stays"
        );
        assert_eq!(bench.throttle(0), 102);
    }
    let (bench, talon) = TalonBench::enabled();
    talon.set_forward_soft_limit(-10).unwrap();
    talon.set_reverse_soft_limit(10).unwrap();
    talon.enable_forward_soft_limit(true).unwrap();
    talon.enable_reverse_soft_limit(true).unwrap();
    bench.run(60);
    let both = fault::FORWARD_SOFT_LIMIT | fault::REVERSE_SOFT_LIMIT;
    assert_eq!(talon.faults().fresh().unwrap().0, both);
    assert_eq!(talon.sticky_faults().fresh().unwrap().0, both);
}

#[test]
fn row_98_over_temperature_under_voltage_and_current_never_stop_a_full_drive() {
    let (bench, talon) = TalonBench::enabled();
    talon.set(0.9).unwrap();
    bench.poke(0, Poke::TemperatureCelsius(Some(120.0)));
    bench.poke(0, Poke::BatteryVolts(Some(6.2)));
    bench.poke(0, Poke::Stall(true));
    for _ in 0..1000 {
        bench.run(5);
        assert_eq!(bench.throttle(0), 920);
    }
    assert!(bench.truth(0).current_a > 40.0);
}

#[test]
fn row_63_row_19_clearing_sticky_faults_clears_all_and_a_present_fault_comes_back() {
    let (bench, talon) = TalonBench::enabled();
    for poke in [
        Poke::ForwardLimitClosed(true),
        Poke::ReverseLimitClosed(true),
        Poke::BatteryVolts(Some(6.0)),
    ] {
        bench.poke(0, poke);
    }
    bench.run(100);
    bench.poke(0, Poke::ForwardLimitClosed(false));
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.run(100);
    let three = fault::FORWARD_LIMIT_SWITCH | fault::REVERSE_LIMIT_SWITCH | fault::BUS_VOLTAGE;
    assert_eq!(talon.sticky_faults().fresh().unwrap().0, three);
    talon.clear_sticky_faults().unwrap();
    bench.run(60);
    assert_eq!(
        talon.sticky_faults().fresh().unwrap().0,
        fault::REVERSE_LIMIT_SWITCH
    );
    bench.poke(0, Poke::ReverseLimitClosed(false));
    bench.run(60);
    // The short form of other clients does the same.
    bench.inject(windlass_core::frame::Frame::extended(
        id::CONTROL_3 | 3,
        [2],
    ));
    bench.run(60);
    assert!(talon.sticky_faults().fresh().unwrap().is_empty());
}

#[test]
fn row_19_a_second_self_test_in_quick_succession_clears_sticky_faults() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::BatteryVolts(Some(6.0)));
    bench.run(100);
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.run(100);
    let first = talon.self_test().unwrap();
    assert!(first.to_string().contains("Under Vbat") && !first.cleared);
    bench.run(4_000);
    let slow = talon.self_test().unwrap();
    assert!(
        !slow.cleared && !slow.sticky_faults().is_empty(),
        "not in quick succession"
    );
    bench.run(300);
    let second = talon.self_test().unwrap();
    assert!(second.cleared && second.sticky_faults().is_empty());
    assert!(second.enabled() && second.to_string().contains("is ENABLED"));
}

#[test]
fn row_18_row_76_sticky_faults_survive_a_power_cycle() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::BatteryVolts(Some(6.0)));
    bench.poke(0, Poke::ForwardLimitClosed(true));
    bench.run(100);
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.poke(0, Poke::ForwardLimitClosed(false));
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    let sticky = talon.sticky_faults().fresh().unwrap().0;
    assert_eq!(sticky, fault::BUS_VOLTAGE | fault::FORWARD_LIMIT_SWITCH);
    assert!(talon.faults().fresh().unwrap().is_empty());
}

#[test]
fn row_51_a_change_after_15_quiet_seconds_is_saved_at_once() {
    let (bench, talon) = TalonBench::enabled();
    bench.run(16_000);
    for p in [0.5, 0.6] {
        let before = bench.truth(0).flash_writes;
        talon.set_p(p).unwrap();
        bench.run(100);
        assert_eq!(bench.truth(0).flash_writes, before + 1);
        bench.run(16_000);
        assert_eq!(bench.truth(0).flash_writes, before + 1);
    }
}

#[test]
fn row_52_a_further_change_is_saved_15_s_after_the_last_save() {
    let (bench, talon) = TalonBench::enabled();
    bench.run(16_000);
    let writes = || bench.truth(0).flash_writes;
    let before = writes();
    talon.set_p(0.5).unwrap();
    let saved_at = bench.robot.now();
    bench.run(3_000);
    talon.set_p(0.6).unwrap();
    bench.run(5_000);
    talon.set_p(0.7).unwrap();
    while bench.robot.now() < saved_at + std::time::Duration::from_millis(14_900) {
        bench.run(10);
    }
    assert_eq!(
        writes(),
        before + 1,
        "not before 15 s have passed since the save"
    );
    bench.run(300);
    assert_eq!(writes(), before + 2, "15 s after it");
    bench.run(30_000);
    assert_eq!(writes(), before + 2);
}

#[test]
fn row_53_the_same_value_again_writes_nothing() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_p(0.5).unwrap();
    bench.run(16_000);
    let before = bench.truth(0).flash_writes;
    for _ in 0..20 {
        talon.set_p(0.5).unwrap();
        bench.run(1_000);
    }
    assert_eq!(bench.truth(0).flash_writes, before);
}

#[test]
fn row_55_constant_change_is_saved_once_in_15_s() {
    let (bench, talon) = TalonBench::enabled();
    bench.run(16_000);
    let before = bench.truth(0).flash_writes;
    for step in 0..600 {
        talon.set_p(f64::from(step) * 0.01).unwrap();
        bench.run(96);
    }
    let saves = bench.truth(0).flash_writes - before;
    assert!((4..=5).contains(&saves), "{saves} saves in a minute");
}

#[test]
fn every_parameter_of_the_table_is_answered_in_4_ms_and_others_are_not() {
    let (bench, talon) = TalonBench::enabled();
    for row in TABLE {
        talon.parameter(row.id).unwrap();
    }
    for parameter in [0, 7, 10, 54, 72, 92, 200, 255] {
        let from = bench.next_frame();
        bench.inject(ParameterRequest { parameter }.emit(3));
        bench.run(20);
        assert!(
            bench.frames(from, id::PARAMETER_RESPONSE, 3).is_empty(),
            "{parameter}"
        );
    }
    // What can only be read answers a set with the value in force.
    let volts = talon.parameter_value(Parameter::Battery).unwrap();
    assert!((volts - bench.truth(0).bus_v).abs() < 0.2, "{volts}");
    let error = talon.set_parameter(Parameter::Battery, 0).unwrap_err();
    assert_eq!(error.code(), 3);
}
