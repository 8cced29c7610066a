//! Status frames, parameters, start-up, mixed buses (rows 18, 34, 35, 94 to 96).

use windlass_core::dialect::talon_srx::wire::{
    Control2, LimitOverride, ModeSelect, Parameter, ParameterRequest, ParameterValue, Status5,
    TABLE, battery, current, id, temperature,
};
use windlass_core::frc_id;
use windlass_sim::Poke;

use crate::bench::{Bench, duty};

/// Times between frames of a kind in ms, over a second.
fn periods(bench: &mut Bench, base: u32) -> Vec<f64> {
    bench.drain();
    bench.run(1000);
    let times: Vec<u64> = bench
        .drain()
        .iter()
        .filter(|received| received.frame.raw_id() == frc_id::with_number(base, 3))
        .map(|received| received.at.as_micros())
        .collect();
    times
        .windows(2)
        .map(|pair| (pair[1] - pair[0]) as f64 / 1000.0)
        .collect()
}

#[test]
fn default_periods_hold_within_a_millisecond_disabled_or_not() {
    for enabled in [false, true] {
        let mut bench = Bench::new(&["talon:3"]);
        if enabled {
            bench.drive(3, duty(100), 50);
        }
        for (base, period) in [
            (id::STATUS_1, 10.0),
            (id::STATUS_2, 20.0),
            (id::STATUS_3, 100.0),
            (id::STATUS_4, 100.0),
        ] {
            let seen = periods(&mut bench, base);
            assert!(seen.len() as f64 >= 1000.0 / period - 2.0);
            assert!(
                seen.iter().all(|at| (at - period).abs() <= 1.0),
                "{base:x} {seen:?}"
            );
        }
    }
}

#[test]
fn periods_are_changed_one_by_one_and_are_back_after_a_reset() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.send(
        Control2 {
            periods: [5, 0, 0, 255],
        }
        .emit(3),
    );
    bench.run(300);
    for (base, period) in [
        (id::STATUS_1, 5.0),
        (id::STATUS_2, 20.0),
        (id::STATUS_4, 255.0),
    ] {
        let seen = periods(&mut bench, base);
        assert!(
            seen.iter().all(|at| (at - period).abs() <= 1.0),
            "{base:x} {seen:?}"
        );
    }
    bench.world.power_cycle(0);
    bench.run(50);
    bench.send(windlass_core::frame::Frame::extended(0x1FFF_FFFF, []));
    bench.run(50);
    assert!(
        periods(&mut bench, id::STATUS_1)
            .iter()
            .all(|at| (at - 10.0).abs() <= 1.0)
    );
}

#[test]
fn the_start_up_frame_comes_once_after_a_reset_with_the_version() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.world.power_cycle(0);
    bench.drain();
    bench.run(50);
    bench.send(windlass_core::frame::Frame::extended(0x1FFF_FFFF, []));
    bench.run(500);
    let frames = bench.drain();
    let start_up: Vec<_> = frames
        .iter()
        .filter(|received| received.frame.raw_id() == id::STATUS_5 | 3)
        .filter_map(|received| Status5::parse(&received.frame))
        .collect();
    assert_eq!(start_up.len(), 1);
    let [major, minor] = start_up[0].version;
    assert!((major, minor) >= (1, 1), "{major}.{minor}");
    assert_ne!(start_up[0].version, [255, 255]);
}

#[test]
fn every_documented_parameter_answers_within_4_ms_and_no_other_does() {
    let mut bench = Bench::new(&["talon:0"]);
    for code in 0..=255_u8 {
        let known = TABLE.iter().any(|row| row.id.code() == code);
        let request = ParameterRequest { parameter: code }.emit(0);
        assert_eq!(
            bench.ask(0, request, code).is_some(),
            known,
            "request {code}"
        );
        let set = ParameterValue {
            parameter: code,
            value: 1,
        }
        .emit_set(0);
        assert_eq!(bench.ask(0, set, code).is_some(), known, "set {code}");
    }
}

#[test]
fn stored_parameters_read_back_raw_and_survive_a_power_cycle() {
    let mut bench = Bench::new(&["talon:3"]);
    let values = [
        (Parameter::Slot0P, u32::MAX),
        (Parameter::Slot0F, i32::MIN as u32),
        (Parameter::Slot0IZone, 200),
        (Parameter::Slot0Ramp, 256),
        (Parameter::Slot1D, 0x8000_0001),
        (Parameter::ReverseSoftThreshold, -1000_i32 as u32),
    ];
    for (parameter, value) in values {
        assert_eq!(bench.set(3, parameter, value), Some(value), "{parameter:?}");
    }
    assert_eq!(
        bench.set(3, Parameter::Slot0Ramp, 0xFFFF_FFFF),
        Some(256),
        "refused: as it was"
    );
    bench.run(31_000);
    bench.world.power_cycle(0);
    bench.run(100);
    for (parameter, value) in values {
        assert_eq!(bench.get(3, parameter), Some(value), "{parameter:?}");
    }
}

#[test]
fn status_and_mirrors_tell_the_same() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.poke(0, Poke::BatteryVolts(Some(11.0)));
    bench.drive(3, duty(-400), 500);
    bench.control(3, duty(-400));
    let (general, feedback, analog) = (bench.status_1(3), bench.status_2(3), bench.status_4(3));
    bench.control(3, duty(-400));
    assert_eq!((general.throttle, general.mode), (-400, ModeSelect::Duty));
    assert_eq!(general.limits, LimitOverride::STORED);
    assert_eq!(
        bench.get(3, Parameter::AppliedThrottle),
        Some(-400_i32 as u32)
    );
    assert_eq!(bench.get(3, Parameter::ModeSelect), Some(0));
    let truth = bench.truth(0);
    let amperes: f64 = current(feedback.current).to_num();
    assert!(
        (amperes - truth.current_a.abs()).abs() < 0.7,
        "{amperes} {}",
        truth.current_a
    );
    let volts: f64 = battery(analog.battery).to_num();
    assert!((volts - truth.bus_v).abs() < 0.1, "{volts} {}", truth.bus_v);
    let celsius: f64 = temperature(analog.temperature).to_num();
    assert!(
        (celsius - truth.temp_c).abs() < 0.7,
        "{celsius} {}",
        truth.temp_c
    );
    let fine = bench.get(3, Parameter::Battery).expect("an answer");
    assert!((f64::from(fine as i32) / f64::from(1 << 22) - truth.bus_v).abs() < 0.1);
}

#[test]
fn on_a_mixed_bus_each_host_sees_its_own() {
    let mut bench = Bench::new(&["talon:5", "dmc60c:5"]);
    bench.drive(5, duty(500), 50);
    assert_eq!(bench.throttle(), 500);
    assert_eq!(bench.truth(1).duty, 0);
    bench.drain();
    bench.run(200);
    let frames = bench.drain();
    let of = |prefix: u32| {
        frames
            .iter()
            .filter(|received| received.frame.raw_id() >> 16 == prefix)
            .count()
    };
    assert!(of(0x0204) > 20 && of(0x0206) > 20);
}
