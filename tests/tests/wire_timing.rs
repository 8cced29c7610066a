//! Everything about time that the guide promises, seen on the bus.

use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect, id};
use windlass_core::engine::snapshot::Fault;
use windlass_core::frame::Frame;
use windlass_core::management::wire::{EnumerateResponse1, VendorCommand, id as management};
use windlass_core::time::{Duration, Instant, TICK};
use windlass_sim::{Poke, WorldConfig};
use windlass_tests::{Bench, control, fixed, ms};

const DEVICE: u8 = 5;

/// Runs in steps of one tick until `done`; gives the time it took.
fn until(bench: &mut Bench, limit: Duration, done: fn(&Bench) -> bool) -> Duration {
    let start = bench.world.now();
    while !done(bench) {
        assert!(bench.world.now().since(start) < limit, "nothing happened");
        bench.run(TICK);
    }
    bench.world.now().since(start)
}

fn near(span: Duration, millis: f64, ticks: f64) {
    let error = span.as_micros() as f64 / 1000.0 - millis;
    assert!(
        error.abs() <= ticks * 0.5,
        "{span:?} instead of {millis} ms"
    );
}

#[test]
fn i2_output_goes_to_zero_104_ms_after_the_last_control_frame() {
    let mut bench = Bench::new(&[DEVICE]);
    bench.drive(DEVICE, &control(ModeSelect::Voltage, 9_000), 200);
    bench
        .world
        .send(bench.tool, control(ModeSelect::Voltage, 9_000).emit(DEVICE));
    let span = until(&mut bench, ms(200), |bench| bench.truth(0).duty == 0);
    near(span, 104.0, 2.0);
    // Parameter traffic is no heartbeat.
    bench.drive(DEVICE, &control(ModeSelect::Voltage, 9_000), 50);
    bench.set(DEVICE, &[(10, 1)]);
    bench.run(ms(20));
    assert_eq!(bench.truth(0).duty, 0);
}

#[test]
fn status_frames_keep_their_periods_within_one_tick() {
    let mut bench = Bench::new(&[DEVICE]);
    bench.set(DEVICE, &[(91, 250), (92, 33), (93, 7)]);
    bench.run(ms(300));
    bench.log.clear();
    bench.run(ms(2_000));
    for (base, period) in [
        (id::STATUS_ANALOG, 250.0),
        (id::STATUS_ENCODER, 33.0),
        (id::STATUS_GENERAL, 7.0),
    ] {
        let frames = bench.received(base, DEVICE);
        assert!(frames.len() as f64 >= 2_000.0 / period - 1.0);
        for pair in frames.windows(2) {
            near(pair[1].0.since(pair[0].0), period, 1.0);
        }
    }
}

#[test]
fn enumeration_answers_come_0_5_to_63_5_ms_after_the_request() {
    let mut numbered = Bench::new(&[1, 30, 63]);
    numbered
        .world
        .send(numbered.tool, Frame::extended(management::ENUMERATE, []));
    let start = numbered.world.now();
    numbered.run(ms(100));
    for number in [1, 30, 63] {
        let answers = numbered.received(management::ENUMERATE_RESPONSE, number);
        assert_eq!(answers.len(), 2);
        near(answers[0].0.since(start), f64::from(number), 2.0);
        assert!(EnumerateResponse1::parse(&answers[1].1).is_some());
    }
    for seed in 0..20 {
        let mut bench = Bench::with(
            WorldConfig {
                seed,
                ..WorldConfig::default()
            },
            &[0],
        );
        let start = bench.world.now();
        bench
            .world
            .send(bench.tool, Frame::extended(management::ENUMERATE, []));
        bench.run(ms(100));
        let session = bench
            .world
            .node(0)
            .unwrap()
            .node()
            .unwrap()
            .session()
            .unwrap();
        let answers = bench.received(management::ENUMERATE_RESPONSE, 0);
        near(
            answers[0].0.since(start),
            f64::from((session & 0x7F).max(1)) * 0.5,
            2.0,
        );
    }
}

#[test]
fn two_devices_of_one_number_are_told_apart_by_session_and_renumbered() {
    for seed in 0..10 {
        let mut bench = Bench::with(
            WorldConfig {
                seed,
                ..WorldConfig::default()
            },
            &[0, 0],
        );
        // A collision costs the round; the devices then differ in the next one.
        let found = (0..3)
            .map(|_| bench.enumerate())
            .find(|found| found.len() == 2);
        let found = found.unwrap_or_else(|| panic!("seed {seed}"));
        assert_ne!(found[0].1, found[1].1);
        assert_eq!(bench.vendor(0, found[1].1, 0x01, 12).unwrap().code, 0);
        let mut numbers: Vec<_> = bench.enumerate();
        numbers.sort_unstable();
        assert_eq!(numbers, [(0, found[0].1), (12, found[1].1)]);
    }
}

#[test]
fn under_voltage_takes_5_s_and_the_fault_state_3_s() {
    let mut bench = Bench::new(&[DEVICE]);
    let frame = control(ModeSelect::Voltage, 3_000);
    bench.poke(0, Poke::BatteryVolts(Some(5.5)));
    bench.drive(DEVICE, &frame, 4_990);
    assert_eq!(bench.truth(0).duty, 3_000);
    bench.drive(DEVICE, &frame, 20);
    assert_eq!((bench.truth(0).duty, bench.truth(0).faults), (0, 4));
    bench.drive(DEVICE, &frame, 4_000);
    assert_eq!(bench.truth(0).duty, 0, "still too low");
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.drive(DEVICE, &frame, 2_990);
    assert_eq!(bench.truth(0).duty, 0);
    bench.drive(DEVICE, &frame, 20);
    assert_eq!((bench.truth(0).duty, bench.truth(0).faults), (3_000, 0));
}

#[test]
fn i3_a_short_circuit_switches_off_within_a_tick() {
    let mut bench = Bench::new(&[DEVICE]);
    let frame = control(ModeSelect::Voltage, 3_000);
    bench.drive(DEVICE, &frame, 100);
    bench.poke(0, Poke::ShortCircuit(true));
    bench.run(TICK + TICK);
    assert_eq!(bench.truth(0).duty, 0);
    bench.poke(0, Poke::ShortCircuit(false));
    bench.drive(DEVICE, &frame, 20);
    assert!(bench.general(DEVICE).faults.contains(Fault::GateDriver));
}

#[test]
fn voltage_ramp_of_2500_takes_the_guide_s_two_ticks() {
    let mut bench = Bench::new(&[DEVICE]);
    bench.drive(DEVICE, &control(ModeSelect::Voltage, 5_000), 50);
    let ramped = Control0 {
        ramp: 2_500,
        ..control(ModeSelect::Voltage, 10_000)
    };
    bench.world.send(bench.tool, ramped.emit(DEVICE));
    let mut seen = vec![bench.truth(0).duty];
    for _ in 0..6 {
        bench.run(TICK);
        seen.push(bench.truth(0).duty);
    }
    seen.dedup();
    assert_eq!(seen, [5_000, 7_500, 10_000]);
}

#[test]
fn closed_loop_ramp_16_takes_1_02_s() {
    let mut bench = Bench::new(&[DEVICE]);
    bench.set(DEVICE, &[(10, fixed(30_000.0)), (16, 16)]);
    let mut millis = 0;
    while bench.truth(0).duty < 32_767 {
        bench.drive(DEVICE, &control(ModeSelect::Position, 8_000_000), 10);
        millis += 10;
        assert!(millis < 2_000);
    }
    assert!((1_020..=1_040).contains(&millis), "{millis} ms");
}

#[test]
fn a_lost_bus_means_off_a_new_session_and_a_counted_fault() {
    let mut bench = Bench::new(&[DEVICE]);
    let before = bench.session(DEVICE);
    bench.drive(DEVICE, &control(ModeSelect::Voltage, 9_000), 50);
    bench.poke(0, Poke::BusConnected(false));
    // Unacknowledged status frames make the controller error passive; the motor stops at the same time.
    let span = until(&mut bench, ms(104), |bench| {
        bench.truth(0).session.is_none()
    });
    bench.run(TICK);
    assert_eq!(bench.truth(0).duty, 0, "{span:?}");
    bench.poke(0, Poke::BusConnected(true));
    bench.run(ms(200));
    bench.send(Frame::extended(0x1FFF_FFFF, []));
    let after = bench.session(DEVICE);
    assert_ne!(before, after);
    assert_eq!(bench.truth(0).counters.bus_losses, 1);
    let old = VendorCommand {
        session: before,
        command: 0x61,
        param1: 0,
        param2: 0,
    };
    bench.log.clear();
    bench.send(old.emit(DEVICE));
    assert!(bench.received(management::VENDOR_STATUS, DEVICE).is_empty());
}

#[test]
fn restarts_are_acknowledged_unasked_in_the_same_session() {
    let mut bench = Bench::new(&[DEVICE]);
    let session = bench.session(DEVICE);
    for (command, code) in [(0xF1, 7), (0xF0, 4), (0xF1, 7)] {
        assert_eq!(bench.vendor(DEVICE, session, command, 0), None);
        bench.run(ms(100));
        let answers = bench.received(management::VENDOR_STATUS, DEVICE);
        assert_eq!(answers.len(), 1);
        assert_eq!(answers[0].1.data(), [code, 0, 0, 0]);
        assert_eq!(bench.session(DEVICE), session);
    }
}

#[test]
fn settings_survive_a_power_cut_after_the_15_s_rule_has_written_them() {
    let mut bench = Bench::new(&[DEVICE]);
    bench.set(DEVICE, &[(10, 111)]);
    bench.run(ms(10));
    bench.set(DEVICE, &[(10, 222)]);
    bench.run(ms(14_000));
    bench.world.power_cycle(0);
    bench.run(ms(50));
    bench.send(Frame::extended(0x1FFF_FFFF, []));
    assert_eq!(
        bench
            .world
            .node(0)
            .unwrap()
            .stored()
            .params
            .get(windlass_core::params::table::ParameterId::Slot0P),
        111
    );
    bench.set(DEVICE, &[(10, 333)]);
    bench.run(ms(10));
    bench.world.power_cycle(0);
    bench.run(ms(50));
    assert_eq!(
        bench
            .world
            .node(0)
            .unwrap()
            .stored()
            .params
            .get(windlass_core::params::table::ParameterId::Slot0P),
        333
    );
}

#[test]
fn instants_never_run_backwards_for_a_node() {
    let mut bench = Bench::new(&[DEVICE]);
    let mut last = Instant::ZERO;
    bench.send(Frame::extended(0x1FFF_FFFF, []));
    bench.run(ms(500));
    for received in &bench.log {
        assert!(received.at >= last);
        last = received.at;
    }
    assert!(bench.log.len() > 50);
}
