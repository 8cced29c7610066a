//! Talon SRX: enable, modes, ramps, followers, control rate. The numbers are the rows of
//! docs/talon-srx-rows.md.

use windlass::client::talon::{ControlMode, EnableStyle, NeutralMode, StatusFrame};
use windlass_core::dialect::talon_srx::wire::{
    BrakeOverride, Control1, Control5, FeedbackDevice, General, GlobalEnable, ModeSelect, id,
};
use windlass_core::engine::command::Neutral;
use windlass_core::frame::Frame;
use windlass_sim::Poke;
use windlass_tests::talon::{TalonBench, VELOCITY};

fn duty(demand: i32) -> General {
    General {
        demand,
        mode: ModeSelect::Duty,
        ..General::default()
    }
}

#[test]
fn row_20_a_control_frame_drives_the_device_with_its_number_only() {
    let bench = TalonBench::new(&["talon:3", "talon:4", "dmc60c:3"]);
    let talon = bench.talon(3);
    bench.robot.enable().unwrap();
    talon.set(0.5).unwrap();
    bench.run(200);
    assert_eq!(
        (bench.throttle(0), bench.throttle(1), bench.throttle(2)),
        (511, 0, 0)
    );
    assert_eq!(talon.applied_throttle().fresh().unwrap(), 511);
}

#[test]
fn row_87_throttle_reaches_1023_both_ways_and_0_is_neutral() {
    let (bench, talon) = TalonBench::enabled();
    for (value, throttle) in [
        (1.0, 1023),
        (-1.0, -1023),
        (0.25, 255),
        (-0.001, -1),
        (0.0, 0),
    ] {
        talon.set(value).unwrap();
        bench.run(50);
        assert_eq!(bench.throttle(0), throttle);
        assert_eq!(
            i32::from(talon.applied_throttle().fresh().unwrap()),
            throttle
        );
    }
}

#[test]
fn row_66_settings_made_while_disabled_act_with_the_first_frame_after_enabling() {
    let bench = TalonBench::new(&["talon:3"]);
    let talon = bench.talon(3);
    talon.config_neutral_mode(NeutralMode::Coast).unwrap();
    talon.set(0.4).unwrap();
    bench.run(300);
    let before = bench.truth(0);
    assert_eq!((before.duty, before.neutral), (0, Neutral::Brake));
    assert!(talon.brake_enable_during_neutral().fresh().unwrap());
    let from = bench.next_frame();
    bench.robot.enable().unwrap();
    bench.run(2);
    assert_eq!(bench.frames(from, id::CONTROL_1, 3).len(), 1);
    assert_eq!(bench.throttle(0), 409);
    assert_eq!(bench.truth(0).neutral, Neutral::Coast);
}

#[test]
fn i2_row_66_silence_of_100_ms_disables_within_a_tick() {
    let (bench, talon) = TalonBench::enabled();
    talon.set(1.0).unwrap();
    bench.run(100);
    // The robot's frames end here: only the world goes on.
    bench.world(|world| world.advance(windlass_tests::ms(89)));
    assert_eq!(bench.throttle(0), 1023);
    bench.world(|world| world.advance(windlass_tests::ms(12)));
    assert_eq!(bench.throttle(0), 0);
}

#[test]
fn row_66_disabling_by_broadcast_acts_at_once_without_a_ramp_until_the_next_control_frame() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_ramp_steps(1).unwrap();
    talon.set(1.0).unwrap();
    bench.run(3000);
    assert!(bench.throttle(0) > 200);
    bench.robot.disable().unwrap();
    bench.run(2);
    assert_eq!(bench.throttle(0), 0);
    assert!(!bench.truth(0).duty.is_positive());
    bench.run(20);
    assert!(!talon.is_enabled().fresh().unwrap());
    bench.robot.enable().unwrap();
    bench.run(15);
    assert!(talon.is_enabled().fresh().unwrap());
    assert!(bench.throttle(0) > 0 && bench.throttle(0) <= 2);
}

#[test]
fn global_enable_drives_several_nodes_and_its_zero_stops_all_of_them_at_once() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let robot = bench.robot.clone().with_enable_style(EnableStyle::Global);
    let (first, second) = (bench.talon(3), bench.talon(4));
    first.set(0.5).unwrap();
    second.set(-0.5).unwrap();
    bench.run(200);
    assert_eq!((bench.throttle(0), bench.throttle(1)), (0, 0));
    robot.enable().unwrap();
    bench.run(20);
    assert_eq!((bench.throttle(0), bench.throttle(1)), (511, -511));
    robot.disable().unwrap();
    bench.run(2);
    assert_eq!((bench.throttle(0), bench.throttle(1)), (0, 0));
    // It wins over a Control_1 of somebody else until the next global enable.
    bench.control(3, duty(900));
    bench.run(1);
    assert_eq!(bench.throttle(0), 0);
    robot.enable().unwrap();
    bench.run(20);
    assert_eq!(bench.throttle(0), 511);
}

#[test]
fn the_short_control_1_enables_and_control_5_tells_what_to_do() {
    let bench = TalonBench::new(&["talon:3"]);
    let content = Control5 {
        bump: 0,
        general: duty(300),
    };
    let enable = Control1 {
        token: 0,
        general: None,
    };
    bench.inject(content.emit(3));
    bench.run(1);
    assert_eq!(bench.throttle(0), 0, "content alone");
    bench.inject(enable.emit(3));
    bench.run(1);
    assert_eq!(bench.throttle(0), 300);
    // Without new content for 100 ms it ends although the enable goes on.
    for _ in 0..3 {
        bench.run(45);
        bench.inject(enable.emit(3));
    }
    assert_eq!(bench.throttle(0), 0);
    bench.inject(GlobalEnable { enabled: true }.emit());
}

#[test]
fn row_21_every_control_period_from_1_to_95_ms_is_followed() {
    for period in [1, 5, 10, 50, 95] {
        let bench = TalonBench::new(&["talon:3"]);
        let talon = bench.robot.talon_with_period(3, period).unwrap();
        bench.robot.enable().unwrap();
        talon.set(0.5).unwrap();
        for _ in 0..100 {
            bench.run(11);
            assert_eq!(bench.throttle(0), 511, "{period} ms");
        }
    }
}

#[test]
fn row_73_mode_15_is_neutral_and_a_new_mode_waits_for_a_set() {
    let (bench, talon) = TalonBench::enabled();
    talon.set(0.5).unwrap();
    bench.run(100);
    talon.set_control_mode(ControlMode::Speed).unwrap();
    bench.run(30);
    assert_eq!(bench.throttle(0), 0);
    assert_eq!(talon.mode().fresh().unwrap(), ModeSelect::NoDrive);
    let report = talon.self_test().unwrap();
    assert!(report.to_string().contains("No Drive"));
    for (neutral, truth) in [
        (NeutralMode::Coast, Neutral::Coast),
        (NeutralMode::Brake, Neutral::Brake),
    ] {
        talon.config_neutral_mode(neutral).unwrap();
        bench.run(5);
        assert_eq!(bench.truth(0).neutral, truth);
    }
}

#[test]
fn row_75_motor_safety_ends_the_drive_and_enable_with_set_resumes() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_safety_enabled(true);
    talon.set(0.5).unwrap();
    bench.run(95);
    assert_eq!(bench.throttle(0), 511);
    bench.run(10);
    assert_eq!(bench.throttle(0), 0);
    bench.run(20);
    assert_eq!(talon.mode().fresh().unwrap(), ModeSelect::NoDrive);
    talon.set(0.5).unwrap();
    bench.run(20);
    assert_eq!(bench.throttle(0), 0);
    talon.enable_control();
    talon.set(0.5).unwrap();
    bench.run(20);
    assert_eq!(bench.throttle(0), 511);
}

/// Watches the terminals of a node for `millis`: the largest single change of the throttle, the shortest time
/// between two changes in µs, and the milliseconds after which `until` was reached.
fn watch(bench: &TalonBench, index: usize, millis: u64, until: i32) -> (i32, u64, Option<u64>) {
    let (mut largest, mut shortest, mut reached) = (0, u64::MAX, None);
    let (mut throttle, mut changed_at) = (bench.throttle(index), None);
    for tick in 1..=millis * 2 {
        bench.run_us(500);
        let now = bench.throttle(index);
        if now != throttle {
            largest = largest.max((now - throttle).abs());
            if let Some(before) = changed_at.replace(tick) {
                shortest = shortest.min((tick - before) * 500);
            }
            throttle = now;
        }
        if now == until && reached.is_none() {
            reached = Some(tick / 2);
        }
    }
    (largest, shortest, reached)
}

#[test]
fn row_36_voltage_ramp_limits_the_change_per_10_ms_both_ways() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_ramp_steps(10).unwrap();
    talon.set(1.0).unwrap();
    let (largest, shortest, full) = watch(&bench, 0, 1200, 1023);
    assert_eq!((largest, shortest), (10, 10_000));
    assert!((1010..=1030).contains(&full.unwrap()), "{full:?}");
    talon.set(-1.0).unwrap();
    let (largest, shortest, full) = watch(&bench, 0, 2300, -1023);
    assert_eq!((largest, shortest), (10, 10_000));
    assert!((2030..=2060).contains(&full.unwrap()), "{full:?}");
    // 0 switches it off.
    talon.set_ramp_steps(0).unwrap();
    talon.set(1.0).unwrap();
    bench.run(2);
    assert_eq!(bench.throttle(0), 1023);
}

#[test]
fn row_36_voltage_ramp_acts_in_closed_loops_and_followers_too() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let (master, slave) = (bench.talon(3), bench.talon(4));
    bench.robot.enable().unwrap();
    bench.run(20);
    master.set_profile(0, &VELOCITY).unwrap();
    master.set_ramp_steps(20).unwrap();
    master.set_control_mode(ControlMode::Speed).unwrap();
    slave.set_control_mode(ControlMode::Follower).unwrap();
    slave.set_ramp_steps(5).unwrap();
    slave.set(3.0).unwrap();
    master.set(30_000.0).unwrap();
    let (largest, shortest, _) = watch(&bench, 0, 400, 0);
    assert!(largest <= 20 && shortest >= 10_000, "{largest} {shortest}");
    assert!(bench.throttle(0) > 500);
    let (largest, shortest, _) = watch(&bench, 1, 600, 0);
    assert!(largest <= 5 && shortest >= 10_000, "{largest} {shortest}");
    assert!(bench.throttle(1) > 400);
}

#[test]
fn row_45_followers_mirror_their_master_in_chains_and_any_mode() {
    let bench = TalonBench::new(&["talon:0", "talon:17", "talon:62"]);
    let (master, slave, slave_of_slave) = (bench.talon(0), bench.talon(17), bench.talon(62));
    bench.robot.enable().unwrap();
    bench.run(20);
    for (follower, master) in [(&slave, 0.0), (&slave_of_slave, 17.0)] {
        follower.set_control_mode(ControlMode::Follower).unwrap();
        follower.set(master).unwrap();
    }
    for value in [0.5, -1.0, 0.125] {
        master.set(value).unwrap();
        bench.run(40);
        let expected = (1023.0 * value) as i32;
        let seen = [0, 1, 2].map(|index| bench.throttle(index));
        assert_eq!(seen, [expected; 3]);
    }
    master.set_profile(0, &VELOCITY).unwrap();
    master.set_control_mode(ControlMode::Speed).unwrap();
    master.set(10_000.0).unwrap();
    bench.run(1000);
    let seen = [0, 1, 2].map(|index| bench.throttle(index));
    assert!(
        seen[0] > 200 && seen.iter().all(|throttle| throttle.abs_diff(seen[0]) < 10),
        "{seen:?}"
    );
    // Its own limit switch still counts.
    bench.poke(1, Poke::ForwardLimitClosed(true));
    bench.run(40);
    assert_eq!((bench.throttle(1), bench.throttle(2)), (0, 0));
    assert!(bench.throttle(0) > 200);
}

#[test]
fn row_41_reversed_output_turns_a_follower_and_a_loop_but_not_the_duty_cycle() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let (master, slave) = (bench.talon(3), bench.talon(4));
    bench.robot.enable().unwrap();
    bench.run(20);
    slave.set_control_mode(ControlMode::Follower).unwrap();
    slave.reverse_output(true).unwrap();
    slave.set(3.0).unwrap();
    master.reverse_output(true).unwrap();
    master.set(0.5).unwrap();
    bench.run(50);
    assert_eq!((bench.throttle(0), bench.throttle(1)), (511, -511));
    master.set_f(0.01).unwrap();
    master.set_control_mode(ControlMode::Speed).unwrap();
    master.set(10_000.0).unwrap();
    bench.run(50);
    assert_eq!((bench.throttle(0), bench.throttle(1)), (-99, 99));
}

#[test]
fn row_46_a_follower_stops_100_ms_after_its_master_and_stays_enabled() {
    let bench = TalonBench::new(&["talon:3", "talon:4"]);
    let (master, slave) = (bench.talon(3), bench.talon(4));
    bench.robot.enable().unwrap();
    slave.set_control_mode(ControlMode::Follower).unwrap();
    slave.set(3.0).unwrap();
    master.set(0.5).unwrap();
    bench.run(200);
    bench.poke(0, Poke::Powered(false));
    bench.run(85);
    assert_eq!(bench.throttle(1), 511);
    bench.run(17);
    assert_eq!(bench.throttle(1), 0);
    bench.run(20);
    assert!(slave.is_enabled().fresh().unwrap());
    // The master comes back.
    bench.poke(0, Poke::Powered(true));
    bench.run(100);
    assert_eq!(bench.throttle(1), 511);
}

#[test]
fn row_97_what_firmware_1_1_does_not_support_is_neutral_and_mirrored() {
    for code in [3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14] {
        let bench = TalonBench::new(&["talon:3"]);
        bench.control(3, duty(700));
        assert_eq!(bench.throttle(0), 700);
        let mode = ModeSelect::from_code(code);
        for _ in 0..5 {
            bench.control(
                3,
                General {
                    mode,
                    ..duty(0x5000)
                },
            );
            bench.run(9);
        }
        assert_eq!(bench.throttle(0), 0, "mode {code}");
        assert_eq!(bench.talon(3).mode().fresh().unwrap(), mode);
    }
    // EncFalling and later sensors: the sensor reads 0 and the loop is neutral.
    for code in [1, 5, 6, 7, 8, 15] {
        let (bench, talon) = TalonBench::enabled();
        talon.set_f(1.0).unwrap();
        talon
            .set_feedback_device(FeedbackDevice::from_code(code))
            .unwrap();
        talon.set_control_mode(ControlMode::Speed).unwrap();
        talon.set(500.0).unwrap();
        bench.run(50);
        assert_eq!(bench.throttle(0), 0, "sensor {code}");
        assert_eq!(talon.position().fresh().unwrap(), 0);
    }
}

#[test]
fn row_56_one_control_frame_after_a_reset_restores_the_drive() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_profile(1, &VELOCITY).unwrap();
    talon.set_sensor_direction(true).unwrap();
    talon.reverse_output(true).unwrap();
    talon.config_neutral_mode(NeutralMode::Coast).unwrap();
    talon.enable_limit_switch(false, false).unwrap();
    talon.set_ramp_steps(50).unwrap();
    talon.set_control_mode(ControlMode::Speed).unwrap();
    talon.set(8_000.0).unwrap();
    bench.run(1500);
    let before = (bench.truth(0).velocity_counts_per_100ms, bench.throttle(0));
    // Settings are saved at once when nothing was saved in the last 15 s; give the others their time.
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(2_000);
    let truth = bench.truth(0);
    assert!(
        (truth.velocity_counts_per_100ms - before.0).abs() < 200.0,
        "{before:?} {truth:?}"
    );
    assert_eq!(truth.neutral, Neutral::Coast);
    let status = talon.status();
    let (general, feedback) = (
        status.general.unwrap().value,
        status.feedback.unwrap().value,
    );
    assert_eq!(general.mode, ModeSelect::Velocity);
    assert!(feedback.slot_1);
}

#[test]
fn row_96_one_frame_carries_the_nine_items_of_the_manual() {
    let bench = TalonBench::new(&["talon:3"]);
    let general = General {
        demand: -1234,
        slot_1: true,
        feedback: FeedbackDevice::AnalogEncoder,
        limits: windlass_core::dialect::talon_srx::wire::LimitOverride::Forced {
            forward: true,
            reverse: false,
        },
        reverse_sensor: true,
        reverse_output: true,
        brake: BrakeOverride::Coast,
        mode: ModeSelect::Position,
        ramp: 200,
    };
    bench.control(3, general);
    bench.run(50);
    let talon = bench.talon(3);
    let status = talon.status();
    let (shown, feedback) = (
        status.general.unwrap().value,
        status.feedback.unwrap().value,
    );
    assert_eq!(
        (shown.feedback, shown.limits, shown.mode),
        (general.feedback, general.limits, general.mode)
    );
    assert!(feedback.slot_1 && !feedback.brake);
    use windlass_core::dialect::talon_srx::wire::Parameter;
    assert_eq!(talon.parameter(Parameter::RampThrottle).unwrap(), 200);
    assert_eq!(talon.parameter(Parameter::ReverseSensor).unwrap(), 1);
    assert_eq!(talon.parameter(Parameter::ReverseOutput).unwrap(), 1);
    assert_eq!(talon.parameter(Parameter::ProfileSlotSelect).unwrap(), 1);
    let position = talon.position().value;
    assert_eq!(shown.error, -1234 - position);
}

#[test]
fn row_82_1_ms_control_adds_about_15_percent_of_the_bus() {
    let load = |period| {
        let bench = TalonBench::new(&["talon:3"]);
        let talon = bench.robot.talon_with_period(3, period).unwrap();
        bench.robot.enable().unwrap();
        talon.set(0.37).unwrap();
        bench.run(100);
        let before = bench.robot.lend(|client| client.traffic());
        bench.run(1000);
        let after = bench.robot.lend(|client| client.traffic());
        (after.bits - before.bits) as f64 / 1e6 * 100.0
    };
    let (slow, fast) = (load(95), load(1));
    let added = fast - slow;
    println!("1 ms control adds {added:.1} %");
    assert!(
        (13.1..=16.0).contains(&added),
        "1 ms control adds {added:.1} %"
    );
}

#[test]
fn row_95_a_fast_general_status_shows_the_ramp_step_by_step() {
    let (bench, talon) = TalonBench::enabled();
    talon
        .set_status_frame_rate_ms(StatusFrame::General, 1)
        .unwrap();
    talon.set_ramp_steps(10).unwrap();
    talon.set(0.2).unwrap();
    let from = bench.next_frame();
    bench.run(100);
    let frames = bench.general(from, 3);
    let seen: Vec<i16> = frames.iter().map(|status| status.throttle).collect();
    assert!(seen.len() >= 98, "{}", seen.len());
    let steps = seen.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert!((9..=10).contains(&steps), "{seen:?}");
}

#[test]
fn row_101_the_start_up_frames_of_the_published_client_drive_nothing() {
    let bench = TalonBench::new(&["talon:3"]);
    let control = |data: [u8; 8]| Frame::extended(id::CONTROL_1 | 3, data);
    for data in [
        [0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0x20, 0, 0],
        [0, 0, 0, 0, 0, 0x20, 0xF0, 0],
    ] {
        bench.inject(control(data));
        bench.run(5);
        assert_eq!(bench.throttle(0), 0);
    }
    bench.inject(control([0, 0, 0, 1, 0xFF, 0x20, 0, 0]));
    assert_eq!(bench.throttle(0), 511);
    bench.inject(control([0, 0, 0xFF, 0xFC, 1, 0x20, 0, 0]));
    assert_eq!(bench.throttle(0), -1023);
}
