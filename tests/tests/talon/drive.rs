//! Enable, duty cycle, ramps, closed loops, follower (rows 21, 36, 41, 45 to 50, 56, 66, 73, 82, 88, 97).

use windlass_core::dialect::talon_srx::wire::{
    Control1, Control5, General, GlobalEnable, ModeSelect, Parameter,
};
use windlass_core::frame::Frame;
use windlass_sim::Poke;

use crate::bench::{Bench, duty, gain, general};

#[test]
fn i2_silence_is_neutral_100_ms_after_the_last_control_frame() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.drive(3, duty(512), 100);
    assert_eq!(bench.throttle(), 512);
    bench.run(89);
    assert_eq!(bench.throttle(), 512, "99 ms after the last frame");
    bench.run(2);
    assert_eq!(bench.throttle(), 0, "101 ms after the last frame");
}

#[test]
fn i5_a_frame_for_another_device_drives_nothing() {
    let mut bench = Bench::new(&["talon:3", "talon:4", "dmc60c:3"]);
    bench.drive(4, duty(512), 50);
    assert_eq!(
        [0, 1, 2].map(|node| bench.truth(node).duty != 0),
        [false, true, false]
    );
}

#[test]
fn control_frames_of_1_to_95_ms_are_followed() {
    for period in [1, 10, 50, 95] {
        let mut bench = Bench::new(&["talon:3"]);
        for round in 0..20 {
            bench.control(3, duty(100 + round));
            bench.run(period);
            assert_eq!(bench.throttle(), 100 + round, "period {period}");
        }
    }
}

#[test]
fn the_broadcast_disable_and_the_global_disable_act_within_a_millisecond() {
    let mut bench = Bench::new(&["talon:3"]);
    for disable in [
        Frame::extended(0, []),
        GlobalEnable { enabled: false }.emit(),
    ] {
        bench.drive(3, duty(512), 50);
        assert_eq!(bench.throttle(), 512);
        bench.send(disable);
        bench.run(1);
        assert_eq!(bench.throttle(), 0);
        bench.send(GlobalEnable { enabled: true }.emit());
    }
}

#[test]
fn content_without_enable_drives_nothing_and_either_enable_lets_it() {
    let mut bench = Bench::new(&["talon:3"]);
    let content = Control5 {
        bump: 0,
        general: duty(300),
    }
    .emit(3);
    let enables = [
        Control1 {
            token: 0,
            general: None,
        }
        .emit(3),
        GlobalEnable { enabled: true }.emit(),
    ];
    for enable in enables {
        for _ in 0..20 {
            bench.send(content);
            bench.run(10);
        }
        assert_eq!(bench.throttle(), 0);
        assert!(!bench.status_1(3).token_locked);
        for _ in 0..5 {
            bench.send(content);
            bench.send(enable);
            bench.run(10);
        }
        assert_eq!(bench.throttle(), 300);
        bench.run(200);
    }
}

#[test]
fn one_frame_after_a_power_cycle_restores_everything() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.set(3, Parameter::Slot1P, gain(2.0));
    bench.run(20);
    bench.world.power_cycle(0);
    bench.run(100);
    bench.poke(0, Poke::AnalogVolts(Some(1.0)));
    let told = General {
        slot_1: true,
        reverse_output: true,
        ramp: 0,
        feedback: windlass_core::dialect::talon_srx::wire::FeedbackDevice::AnalogPotentiometer,
        ..general(ModeSelect::Position, 400)
    };
    bench.control(3, told);
    bench.run(2);
    let adc = bench.status_2(3).position;
    assert!((309..=311).contains(&adc), "{adc}");
    bench.control(3, told);
    bench.run(5);
    assert_eq!(bench.throttle(), -2 * (400 - adc));
}

#[test]
fn the_voltage_ramp_takes_a_second_to_full_and_limits_every_10_ms() {
    let mut bench = Bench::new(&["talon:3"]);
    let told = General {
        ramp: 10,
        ..duty(1023)
    };
    let mut last = 0;
    for step in 1..=110 {
        bench.control(3, told);
        bench.run(10);
        let throttle = bench.throttle();
        assert!(throttle - last <= 10, "{last} to {throttle}");
        assert_eq!(throttle == 1023, step >= 103, "{throttle} after {step}0 ms");
        last = throttle;
    }
}

#[test]
fn position_and_velocity_loops_hold_their_targets() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.set(3, Parameter::Slot0P, gain(0.15));
    bench.set(3, Parameter::Slot0D, gain(2.5));
    bench.set(3, Parameter::Slot1P, gain(0.02));
    bench.set(3, Parameter::Slot1I, gain(0.0001));
    bench.set(3, Parameter::Slot1F, gain(0.02));
    bench.drive(3, general(ModeSelect::Position, 20_000), 3000);
    let position = bench.status_2(3).position;
    assert!((20_000 - position).abs() < 200, "{position}");
    let told = General {
        slot_1: true,
        ..general(ModeSelect::Velocity, 15_000)
    };
    bench.drive(3, told, 3000);
    let status = bench.status_2(3);
    assert!(
        (15_000 - i32::from(status.velocity)).abs() < 150,
        "{}",
        status.velocity
    );
    assert!(status.slot_1);
    bench.control(3, told);
    assert!(bench.status_1(3).error.abs() < 300);
}

#[test]
fn a_chain_of_followers_copies_turns_and_stops_with_its_master() {
    let mut bench = Bench::new(&["talon:0", "talon:1", "talon:2"]);
    let follow = |of| general(ModeSelect::Follower, of);
    let turned = General {
        reverse_output: true,
        ..follow(1)
    };
    for _ in 0..20 {
        bench.control(0, duty(600));
        bench.control(1, follow(0));
        bench.control(2, turned);
        bench.run(10);
    }
    let throttle = |bench: &Bench, node: usize| {
        windlass_core::units::Duty::new(bench.truth(node).duty).throttle()
    };
    assert_eq!(
        [0, 1, 2].map(|node| throttle(&bench, node)),
        [600, 600, -600]
    );
    bench.poke(0, Poke::Powered(false));
    for step in 0..12 {
        bench.control(1, follow(0));
        bench.control(2, turned);
        bench.run(10);
        if step == 7 {
            assert_eq!(throttle(&bench, 1), 600, "80 ms without a report");
        }
    }
    assert_eq!([1, 2].map(|node| throttle(&bench, node)), [0, 0]);
    assert!(bench.status_1(1).token_locked, "still enabled");
}

#[test]
fn what_firmware_1_1_does_not_have_is_neutral_and_shown() {
    for mode in [
        ModeSelect::Current,
        ModeSelect::VoltageCompensation,
        ModeSelect::Reserved(6),
        ModeSelect::NoDrive,
    ] {
        let mut bench = Bench::new(&["talon:3"]);
        bench.drive(3, duty(500), 30);
        bench.drive(3, general(mode, 5000), 30);
        assert_eq!(bench.throttle(), 0);
        assert_eq!(bench.status_1(3).mode, mode);
    }
}

#[test]
fn changed_gains_act_before_they_are_kept() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.set(3, Parameter::Slot0P, gain(0.1));
    bench.poke(0, Poke::Stall(true));
    bench.run(20_000);
    let told = general(ModeSelect::Position, 1000);
    bench.drive(3, told, 50);
    let first = bench.throttle();
    let writes = bench.truth(0).flash_writes;
    for value in [0.2, 0.3, 0.4] {
        bench.set(3, Parameter::Slot0P, gain(value));
        bench.control(3, told);
        bench.run(2);
        assert!(bench.throttle() > first, "{value}");
    }
    assert_eq!(
        bench.truth(0).flash_writes,
        writes + 1,
        "one at once, the others later"
    );
    for _ in 0..100 {
        bench.set(3, Parameter::Slot0P, gain(0.4));
    }
    bench.run(16_000);
    let kept = bench.truth(0).flash_writes;
    bench.set(3, Parameter::Slot0P, gain(0.4));
    bench.run(16_000);
    assert_eq!(
        bench.truth(0).flash_writes,
        kept,
        "the same value again writes nothing"
    );
}
