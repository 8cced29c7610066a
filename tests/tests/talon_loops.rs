//! Talon SRX: closed loops and motor control profiles. The numbers are the rows of docs/talon-srx-rows.md.

use windlass::client::talon::{ControlMode, Profile, StatusFrame};
use windlass_core::dialect::talon_srx::wire::{FeedbackDevice, Parameter};
use windlass_sim::Poke;
use windlass_tests::talon::{POSITION, Talon, TalonBench, VELOCITY};

/// A Talon whose shaft is locked at position 0, with a general status every millisecond.
fn locked() -> (TalonBench, Talon) {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::Stall(true));
    talon
        .set_status_frame_rate_ms(StatusFrame::General, 1)
        .unwrap();
    talon.set_position(0).unwrap();
    bench.run(30);
    (bench, talon)
}

/// Starts a position loop with this profile and target, without anything left of the loop before.
fn start(bench: &TalonBench, talon: &Talon, profile: &Profile, target: f64) {
    talon.set_control_mode(ControlMode::PercentVbus).unwrap();
    talon.set(0.0).unwrap();
    talon.set_profile(0, profile).unwrap();
    bench.run(20);
    talon.set_control_mode(ControlMode::Position).unwrap();
    talon.set(target).unwrap();
}

#[test]
fn row_47_velocity_and_position_loops_reach_their_targets_on_the_plant() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_profile(0, &VELOCITY).unwrap();
    talon.set_profile(1, &POSITION).unwrap();
    for target in [2_880, 15_000, -10_000] {
        talon.select_profile_slot(0).unwrap();
        talon.set_control_mode(ControlMode::Speed).unwrap();
        talon.set(f64::from(target)).unwrap();
        bench.run(3000);
        let truth = bench.truth(0).velocity_counts_per_100ms;
        let error = (truth - f64::from(target)).abs();
        assert!(error < f64::from(target).abs() * 0.03, "{target}: {truth}");
        let shown = talon.closed_loop_error().fresh().unwrap();
        assert!(
            f64::from(shown).abs() < f64::from(target).abs() * 0.04,
            "{shown}"
        );
    }
    for turns in [1, -3] {
        let target = talon.position().value + turns * 4096;
        talon.select_profile_slot(1).unwrap();
        talon.set_control_mode(ControlMode::Position).unwrap();
        talon.set(f64::from(target)).unwrap();
        bench.run(4000);
        let position = talon.position().fresh().unwrap();
        assert!(position.abs_diff(target) < 20, "{target}: {position}");
        talon.set_control_mode(ControlMode::PercentVbus).unwrap();
        talon.set(0.0).unwrap();
        bench.run(500);
    }
}

#[test]
fn row_92_gains_are_throttle_per_unit_of_error_and_of_the_target() {
    let (bench, talon) = locked();
    // Manual 17.13: a P of 102 is 102 throttle units per unit of error.
    for (p, f, target, throttle) in [
        (102.0, 0.0, 1.0, 102),
        (102.0, 0.0, -3.0, -306),
        (0.0, 2.0, 300.0, 600),
        (0.0, -2.0, 300.0, -600),
        // 0.2 truncates in 10.22: 199, not 200.
        (0.2, 0.0, 1000.0, 199),
        (0.0, 0.0002, 2000.0, 0),
        (1023.0, 0.0, 100_000.0, 1023),
    ] {
        start(
            &bench,
            &talon,
            &Profile {
                p,
                f,
                ..Profile::default()
            },
            target,
        );
        bench.run(20);
        assert_eq!(bench.throttle(0), throttle, "P {p} F {f} target {target}");
    }
}

#[test]
fn row_90_the_accumulator_adds_the_error_every_millisecond() {
    let (bench, talon) = locked();
    start(
        &bench,
        &talon,
        &Profile {
            i: 0.001,
            ..Profile::default()
        },
        10.0,
    );
    bench.run(500);
    let first = talon.iaccum().unwrap();
    let before = bench.robot.now();
    bench.run(1000);
    let second = talon.iaccum().unwrap();
    let millis = (bench.robot.now() - before).as_millis() as i32;
    assert!(
        (second - first).abs_diff(10 * millis) <= 20,
        "{first} {second} in {millis} ms"
    );
    // I 0.001 per accumulated unit, truncated.
    let throttle = bench.throttle(0);
    assert!(throttle.abs_diff(second / 1000) <= 1, "{throttle} {second}");
}

#[test]
fn row_58_clearing_the_accumulator_acts_at_once() {
    let (bench, talon) = locked();
    start(
        &bench,
        &talon,
        &Profile {
            i: 1.0,
            ..Profile::default()
        },
        1.0,
    );
    bench.run(500);
    assert!(bench.throttle(0) > 400);
    talon.clear_iaccum().unwrap();
    bench.run(2);
    assert!(bench.throttle(0) < 10, "{}", bench.throttle(0));
    assert!(talon.iaccum().unwrap() < 10);
}

#[test]
fn row_89_the_i_zone_clears_the_accumulator_at_its_edge_and_0_is_off() {
    let (bench, talon) = locked();
    for (i_zone, target, accumulates) in [
        (200, 199.0, true),
        (200, -199.0, true),
        (200, 200.0, false),
        (200, 201.0, false),
        (200, -200.0, false),
        (0, 100_000.0, true),
    ] {
        let profile = Profile {
            i: 0.0001,
            i_zone,
            ..Profile::default()
        };
        start(&bench, &talon, &profile, target);
        bench.run(200);
        let sum = talon.iaccum().unwrap();
        assert_eq!(
            sum != 0,
            accumulates,
            "zone {i_zone}, error {target}: {sum}"
        );
    }
}

#[test]
fn row_88_the_closed_loop_ramp_moves_the_output_by_throttle_per_millisecond() {
    let (bench, talon) = locked();
    let profile = Profile {
        p: 100.0,
        close_loop_ramp_rate: 12.0,
        ..Profile::default()
    };
    start(&bench, &talon, &profile, 1000.0);
    assert_eq!(talon.parameter(Parameter::Slot0Ramp).unwrap(), 1);
    let from = bench.next_frame();
    bench.run(1200);
    let seen: Vec<i16> = bench
        .general(from, 3)
        .iter()
        .map(|status| status.throttle)
        .collect();
    let steps = seen.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(
        steps.into_iter().all(|step| (0..=3).contains(&step)),
        "{seen:?}"
    );
    let full = seen.iter().position(|throttle| *throttle == 1023).unwrap();
    assert!((990..=1035).contains(&full), "full after {full} ms");
    // The other profile has none, and the duty cycle never has.
    talon
        .set_profile(
            1,
            &Profile {
                p: 100.0,
                ..Profile::default()
            },
        )
        .unwrap();
    talon.set(-1000.0).unwrap();
    bench.run(3);
    assert_eq!(bench.throttle(0), -1023);
    talon.select_profile_slot(0).unwrap();
    talon.set_control_mode(ControlMode::PercentVbus).unwrap();
    talon.set(1.0).unwrap();
    bench.run(3);
    assert_eq!(bench.throttle(0), 1023);
}

#[test]
fn row_48_both_profiles_read_back_and_survive_a_power_cycle() {
    let (bench, talon) = TalonBench::enabled();
    // The values of the manual's web page (11); the ramp of slot 0 is 256 throttle units per ms.
    let zero = Profile {
        p: 0.2,
        i: 0.002,
        d: 2.0,
        f: 0.0002,
        i_zone: 200,
        close_loop_ramp_rate: 256.0 * 12_000.0 / 1023.0 + 0.1,
    };
    let one = Profile {
        p: 0.1,
        i: 0.001,
        d: 1.0,
        f: 0.0001,
        i_zone: 100,
        close_loop_ramp_rate: 0.0,
    };
    talon.set_profile(0, &zero).unwrap();
    talon.set_profile(1, &one).unwrap();
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    for (slot, expected) in [(0, zero), (1, one)] {
        let read = talon.profile(slot).unwrap();
        for (read, expected) in [
            (read.p, expected.p),
            (read.i, expected.i),
            (read.d, expected.d),
            (read.f, expected.f),
        ] {
            assert!((read - expected).abs() < 1e-6, "{read} {expected}");
        }
        assert_eq!(read.i_zone, expected.i_zone);
    }
    assert_eq!(talon.parameter(Parameter::Slot0Ramp).unwrap(), 256);
    // Gains above 511 use the sign bit on the wire and are unsigned all the same.
    talon.set_p(1000.0).unwrap();
    assert_eq!(talon.parameter_value(Parameter::Slot1P).unwrap(), 1000.0);
}

#[test]
fn row_49_the_slot_bit_switches_gains_at_the_next_tick_in_any_loop() {
    let (bench, talon) = locked();
    talon
        .set_profile(
            0,
            &Profile {
                p: 1.0,
                ..Profile::default()
            },
        )
        .unwrap();
    talon
        .set_profile(
            1,
            &Profile {
                p: 5.0,
                ..Profile::default()
            },
        )
        .unwrap();
    for mode in [ControlMode::Position, ControlMode::Speed] {
        talon.set_control_mode(mode).unwrap();
        talon.select_profile_slot(0).unwrap();
        talon.set(100.0).unwrap();
        bench.run(30);
        for (slot, throttle) in [(1, 500), (0, 100), (1, 500)] {
            talon.select_profile_slot(slot).unwrap();
            // The frame needs less than 0.2 ms, the loop runs every 1 ms.
            bench.run_us(1800);
            assert_eq!(bench.throttle(0), throttle, "{mode:?} slot {slot}");
            bench.run(40);
            assert_eq!(talon.profile_slot().fresh().unwrap(), slot);
        }
    }
}

#[test]
fn row_50_a_changed_gain_acts_at_the_next_millisecond_before_it_is_saved() {
    let (bench, talon) = locked();
    start(
        &bench,
        &talon,
        &Profile {
            p: 1.0,
            ..Profile::default()
        },
        100.0,
    );
    bench.run(30);
    let writes = bench.truth(0).flash_writes;
    for p in [2.0, 3.0, 4.0, 5.0] {
        talon.set_p(p).unwrap();
        bench.run_us(1800);
        assert_eq!(bench.throttle(0), (p * 100.0) as i32);
    }
    assert!(bench.truth(0).flash_writes <= writes + 1);
}

#[test]
fn row_91_the_error_is_target_minus_measured_value() {
    let (bench, talon) = locked();
    start(&bench, &talon, &Profile::default(), -777.0);
    bench.run(30);
    assert_eq!(talon.closed_loop_error().fresh().unwrap(), -777);
    talon.set_position(223).unwrap();
    bench.run(30);
    assert_eq!(talon.closed_loop_error().fresh().unwrap(), -1000);
    // Beyond 24 bits the frame saturates.
    talon.set_position(-0x7F_FFFF).unwrap();
    talon.set(f64::from(0x7F_FFFF)).unwrap();
    bench.run(30);
    assert_eq!(talon.closed_loop_error().fresh().unwrap(), 0x7F_FFFF);
}

#[test]
fn row_57_error_throttle_slot_and_sensor_show_in_the_self_test() {
    let (bench, talon) = locked();
    talon
        .set_profile(
            1,
            &Profile {
                p: 2.0,
                ..Profile::default()
            },
        )
        .unwrap();
    talon.set_control_mode(ControlMode::Position).unwrap();
    talon.set(50.0).unwrap();
    bench.run(30);
    let text = talon.self_test().unwrap().to_string();
    for part in [
        "Position closed loop",
        "Closed-loop error     50",
        "Applied throttle      100 (+9.8 %)",
        "Profile slot          1",
        "Quadrature Encoder",
    ] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
}

#[test]
fn row_93_derivative_and_first_pass_follow_the_published_algorithm() {
    let (bench, talon) = locked();
    // D acts on the error: a step of the target kicks for one pass, and not in the first one.
    let profile = Profile {
        p: 0.5,
        d: 10.0,
        ..Profile::default()
    };
    start(&bench, &talon, &profile, 100.0);
    let from = bench.next_frame();
    bench.run(20);
    let seen: Vec<i16> = bench
        .general(from, 3)
        .iter()
        .map(|status| status.throttle)
        .collect();
    assert!(
        seen.iter().all(|throttle| [0, 50].contains(throttle)),
        "{seen:?}"
    );
    let from = bench.next_frame();
    talon.set(110.0).unwrap();
    bench.run(20);
    let seen: Vec<i16> = bench
        .general(from, 3)
        .iter()
        .map(|status| status.throttle)
        .collect();
    let kicks = seen.iter().filter(|throttle| **throttle == 155).count();
    assert_eq!(kicks, 1, "{seen:?}");
    assert_eq!(*seen.last().unwrap(), 55);
}

#[test]
fn row_47_the_loops_work_with_the_analog_sensor_too() {
    let (bench, talon) = TalonBench::enabled();
    // The potentiometer of the plant: 1024 counts in ten turns.
    talon
        .set_feedback_device(FeedbackDevice::AnalogPotentiometer)
        .unwrap();
    let profile = Profile {
        p: 20.0,
        d: 100.0,
        ..Profile::default()
    };
    talon.set_profile(0, &profile).unwrap();
    bench.run(200);
    let start = talon.position().fresh().unwrap();
    assert!(start.abs_diff(512) < 5, "{start}");
    talon.set_control_mode(ControlMode::Position).unwrap();
    talon.set(600.0).unwrap();
    bench.run(4000);
    let end = talon.position().fresh().unwrap();
    assert!(end.abs_diff(600) < 12, "{end}");
}
