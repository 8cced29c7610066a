//! Talon SRX: limit switches, soft limits, neutral. The numbers are the rows of docs/talon-srx-rows.md.

use windlass::client::talon::{ControlMode, LimitMode, NeutralMode, fault};
use windlass_core::dialect::talon_srx::wire::{FeedbackDevice, LimitOverride, Parameter};
use windlass_core::engine::command::Neutral;
use windlass_sim::Poke;
use windlass_tests::talon::{Talon, TalonBench};

/// Closes and opens both switches.
fn switches(bench: &TalonBench, forward: bool, reverse: bool) {
    bench.poke(0, Poke::ForwardLimitClosed(forward));
    bench.poke(0, Poke::ReverseLimitClosed(reverse));
}

/// Whether full throttle forward and in reverse drive.
fn drives(bench: &TalonBench, talon: &Talon) -> (bool, bool) {
    let drives = |value: f64| {
        talon.set(value).unwrap();
        bench.run(30);
        bench.throttle(0) == (value * 1023.0) as i32
    };
    let forward = drives(1.0);
    let reverse = drives(-1.0);
    talon.set(0.0).unwrap();
    bench.run(10);
    (forward, reverse)
}

#[test]
fn row_22_by_default_both_switches_are_normally_open() {
    let (bench, talon) = TalonBench::enabled();
    assert_eq!(drives(&bench, &talon), (true, true));
    switches(&bench, true, false);
    assert_eq!(drives(&bench, &talon), (false, true));
    switches(&bench, false, true);
    assert_eq!(drives(&bench, &talon), (true, false));
    for parameter in [
        Parameter::OnBootForwardNormallyClosed,
        Parameter::OnBootReverseNormallyClosed,
        Parameter::OnBootForwardDisable,
        Parameter::OnBootReverseDisable,
    ] {
        assert_eq!(talon.parameter(parameter).unwrap(), 0, "{parameter:?}");
    }
}

#[test]
fn row_23_the_truth_table_of_the_manual_holds_in_every_combination() {
    // Manual 4.1: what a switch allows, by its mode and state.
    let allows = |mode: u8, closed: bool| match mode {
        0 => !closed,
        1 => closed,
        _ => true,
    };
    for (forward_mode, reverse_mode) in [
        (0, 0),
        (0, 1),
        (1, 0),
        (1, 1),
        (2, 0),
        (0, 2),
        (2, 2),
        (1, 2),
    ] {
        let (bench, talon) = TalonBench::enabled();
        let modes = [
            (
                Parameter::OnBootForwardNormallyClosed,
                Parameter::OnBootForwardDisable,
                forward_mode,
            ),
            (
                Parameter::OnBootReverseNormallyClosed,
                Parameter::OnBootReverseDisable,
                reverse_mode,
            ),
        ];
        for (closed, disabled, mode) in modes {
            talon.set_parameter(closed, u32::from(mode == 1)).unwrap();
            talon.set_parameter(disabled, u32::from(mode == 2)).unwrap();
        }
        bench.run(150);
        for (forward, reverse) in [(false, false), (false, true), (true, false), (true, true)] {
            switches(&bench, forward, reverse);
            let expected = (allows(forward_mode, forward), allows(reverse_mode, reverse));
            assert_eq!(
                drives(&bench, &talon),
                expected,
                "modes {forward_mode} {reverse_mode}, closed {forward} {reverse}"
            );
        }
    }
}

#[test]
fn row_26_neutral_brakes_by_default() {
    let (bench, talon) = TalonBench::enabled();
    assert_eq!(bench.truth(0).neutral, Neutral::Brake);
    assert!(talon.brake_enable_during_neutral().fresh().unwrap());
}

#[test]
fn row_30_row_32_the_brake_override_wins_over_the_stored_mode_and_leaves_it_alone() {
    let (bench, talon) = TalonBench::enabled();
    for stored in [1, 0] {
        talon.set_parameter(Parameter::OnBootBrake, stored).unwrap();
        for (mode, expected) in [
            (NeutralMode::Coast, Neutral::Coast),
            (NeutralMode::Brake, Neutral::Brake),
            (
                NeutralMode::Jumper,
                if stored == 1 {
                    Neutral::Brake
                } else {
                    Neutral::Coast
                },
            ),
        ] {
            talon.config_neutral_mode(mode).unwrap();
            // A change of the stored mode disables for a moment.
            bench.run(150);
            assert_eq!(
                bench.truth(0).neutral,
                expected,
                "{mode:?}, stored {stored}"
            );
            let shown = talon.brake_enable_during_neutral().fresh().unwrap();
            assert_eq!(shown, expected == Neutral::Brake);
            assert_eq!(talon.parameter(Parameter::OnBootBrake).unwrap(), stored);
        }
    }
}

#[test]
fn row_29_the_button_toggles_the_stored_mode_even_under_an_override() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::Button);
    bench.run(150);
    assert_eq!(bench.truth(0).neutral, Neutral::Coast);
    talon.config_neutral_mode(NeutralMode::Brake).unwrap();
    bench.run(30);
    assert_eq!(bench.truth(0).neutral, Neutral::Brake);
    bench.poke(0, Poke::Button);
    bench.run(150);
    assert_eq!(bench.truth(0).neutral, Neutral::Brake);
    assert_eq!(talon.parameter(Parameter::OnBootBrake).unwrap(), 1);
    bench.poke(0, Poke::Button);
    talon.config_neutral_mode(NeutralMode::Jumper).unwrap();
    bench.run(150);
    assert_eq!(bench.truth(0).neutral, Neutral::Coast);
}

#[test]
fn row_31_row_32_limit_overrides_act_per_direction_without_stopping_the_drive() {
    let (bench, talon) = TalonBench::enabled();
    switches(&bench, true, true);
    for (forward, reverse) in [(false, false), (true, false), (false, true), (true, true)] {
        talon.enable_limit_switch(forward, reverse).unwrap();
        assert_eq!(drives(&bench, &talon), (!forward, !reverse));
        let text = talon.self_test().unwrap().to_string();
        let word = |on: bool| {
            if on {
                "closed, forced ON"
            } else {
                "closed, forced OFF"
            }
        };
        assert!(
            text.contains(&format!("Fwd. limit switch     {}", word(forward))),
            "{text}"
        );
        assert!(
            text.contains(&format!("Rev. limit switch     {}", word(reverse))),
            "{text}"
        );
    }
    // Switching the feature on and off never interrupts a drive that no switch blocks.
    switches(&bench, false, false);
    talon.set(0.6).unwrap();
    bench.run(50);
    for enabled in [false, true, false] {
        talon.enable_limit_switch(enabled, enabled).unwrap();
        for _ in 0..40 {
            bench.run_us(500);
            assert_eq!(bench.throttle(0), 613);
        }
    }
    talon.use_stored_limit_switches().unwrap();
    switches(&bench, true, true);
    assert_eq!(drives(&bench, &talon), (false, false));
    let limits = talon.status().general.unwrap().value.limits;
    assert!(matches!(limits, LimitOverride::Stored(_)));
}

#[test]
fn row_28_row_33_changing_normally_open_disables_for_a_moment_and_the_same_value_does_not() {
    let (bench, talon) = TalonBench::enabled();
    talon.set(0.5).unwrap();
    bench.run(100);
    talon.config_fwd_limit_switch_normally_open(true).unwrap();
    for _ in 0..300 {
        bench.run_us(500);
        assert_eq!(bench.throttle(0), 511, "the same value again");
    }
    // The reverse switch: a closed forward direction would hide the moment.
    bench.poke(0, Poke::ReverseLimitClosed(true));
    talon.config_rev_limit_switch_normally_open(false).unwrap();
    let mut neutral_us = 0;
    for _ in 0..400 {
        bench.run_us(500);
        neutral_us += if bench.throttle(0) == 0 { 500 } else { 0 };
    }
    assert_eq!(bench.throttle(0), 511, "it resumes");
    assert!((95_000..=115_000).contains(&neutral_us), "{neutral_us} µs");
    // Every other setting leaves the drive alone.
    let others = [
        (Parameter::Slot0P, 77),
        (Parameter::Slot1Ramp, 3),
        (Parameter::ForwardSoftThreshold, 1_000_000),
        (Parameter::ReverseSoftEnable, 0),
        (Parameter::Slot0IZone, 10),
    ];
    for (parameter, value) in others {
        talon.set_parameter(parameter, value).unwrap();
        for _ in 0..50 {
            bench.run_us(500);
            assert_eq!(bench.throttle(0), 511, "{parameter:?}");
        }
    }
}

#[test]
fn row_33_normally_closed_is_kept_over_a_power_cycle() {
    let (bench, talon) = TalonBench::enabled();
    talon.config_fwd_limit_switch_normally_open(false).unwrap();
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    assert_eq!(
        talon
            .parameter(Parameter::OnBootForwardNormallyClosed)
            .unwrap(),
        1
    );
    assert_eq!(drives(&bench, &talon), (false, true));
}

#[test]
fn row_81_a_closed_switch_that_is_forced_off_shows_its_pin_and_no_fault() {
    let (bench, talon) = TalonBench::enabled();
    talon.enable_limit_switch(false, false).unwrap();
    talon.set(0.5).unwrap();
    bench.poke(0, Poke::ForwardLimitClosed(true));
    bench.run(150);
    assert_eq!(bench.throttle(0), 511);
    assert!(talon.is_fwd_limit_switch_closed().fresh().unwrap());
    assert!(!talon.is_rev_limit_switch_closed().fresh().unwrap());
    assert!(talon.faults().fresh().unwrap().is_empty());
    assert!(talon.sticky_faults().fresh().unwrap().is_empty());
    assert!(talon.forward_limit_ok().fresh().unwrap());
    // Forced on, the fault is there although nothing asks for forward.
    talon.enable_limit_switch(true, true).unwrap();
    talon.set(0.0).unwrap();
    bench.run(50);
    assert_eq!(
        talon.faults().fresh().unwrap().0,
        fault::FORWARD_LIMIT_SWITCH
    );
    assert!(!talon.forward_limit_ok().fresh().unwrap());
    assert!(talon.reverse_limit_ok().fresh().unwrap());
}

#[test]
fn row_43_soft_limits_block_beyond_the_threshold_only_and_leave_the_other_way_free() {
    let (bench, talon) = TalonBench::enabled();
    talon
        .set_feedback_device(FeedbackDevice::Quadrature)
        .unwrap();
    bench.run(30);
    for (position, allowed) in [
        (1000, (true, true)),
        (1001, (false, true)),
        (-500, (true, true)),
        (-501, (true, false)),
    ] {
        // A stalled motor keeps its position.
        bench.poke(0, Poke::Stall(true));
        talon.set_forward_soft_limit(1000).unwrap();
        talon.set_reverse_soft_limit(-500).unwrap();
        talon.enable_forward_soft_limit(true).unwrap();
        talon.enable_reverse_soft_limit(true).unwrap();
        talon.set(0.0).unwrap();
        bench.run(200);
        talon.set_position(position).unwrap();
        bench.run(30);
        assert_eq!(talon.position().fresh().unwrap(), position);
        assert_eq!(drives(&bench, &talon), allowed, "at {position}");
        // Each has its own enable.
        talon.enable_forward_soft_limit(false).unwrap();
        assert_eq!(
            drives(&bench, &talon),
            (true, allowed.1),
            "forward off at {position}"
        );
        talon.enable_reverse_soft_limit(false).unwrap();
        assert_eq!(drives(&bench, &talon), (true, true));
    }
}

#[test]
fn row_43_a_soft_limit_ends_a_drive_where_it_stands() {
    let (bench, talon) = TalonBench::enabled();
    talon.set_forward_soft_limit(20_000).unwrap();
    talon
        .config_limit_mode(LimitMode::SoftPositionLimits)
        .unwrap();
    talon.set_reverse_soft_limit(-20_000).unwrap();
    talon.set(0.3).unwrap();
    bench.run(3000);
    assert_eq!(bench.throttle(0), 0);
    let position = talon.position().fresh().unwrap();
    assert!(position > 20_000, "{position}");
    assert_eq!(talon.faults().fresh().unwrap().0, fault::FORWARD_SOFT_LIMIT);
    talon.set(-0.3).unwrap();
    bench.run(1000);
    assert!(talon.position().fresh().unwrap() < position);
    talon
        .config_limit_mode(LimitMode::SwitchInputsOnly)
        .unwrap();
    assert_eq!(talon.parameter(Parameter::ForwardSoftEnable).unwrap(), 0);
    talon
        .config_limit_mode(LimitMode::DisableSwitchInputs)
        .unwrap();
    bench.run(20);
    let limits = talon.status().general.unwrap().value.limits;
    let off = LimitOverride::Forced {
        forward: false,
        reverse: false,
    };
    assert_eq!(limits, off);
}

#[test]
fn row_44_soft_limit_settings_read_back_and_survive_a_power_cycle() {
    let (bench, talon) = TalonBench::enabled();
    let values = [
        (Parameter::ForwardSoftThreshold, 123_456),
        (Parameter::ReverseSoftThreshold, -123_456_i32 as u32),
        (Parameter::ForwardSoftEnable, 1),
        (Parameter::ReverseSoftEnable, 1),
    ];
    for (parameter, value) in values {
        talon.set_parameter(parameter, value).unwrap();
    }
    bench.run(16_000);
    bench.world(|world| world.power_cycle(0));
    bench.run(300);
    for (parameter, value) in values {
        assert_eq!(talon.parameter(parameter).unwrap(), value, "{parameter:?}");
    }
}

#[test]
fn row_43_soft_limits_follow_the_selected_and_reversed_sensor() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(2.0)));
    talon
        .set_feedback_device(FeedbackDevice::AnalogPotentiometer)
        .unwrap();
    talon.set_forward_soft_limit(500).unwrap();
    talon.enable_forward_soft_limit(true).unwrap();
    talon.set_reverse_soft_limit(-500).unwrap();
    talon.enable_reverse_soft_limit(true).unwrap();
    bench.run(300);
    assert_eq!(drives(&bench, &talon), (false, true));
    talon.set_sensor_direction(true).unwrap();
    bench.run(30);
    assert_eq!(drives(&bench, &talon), (true, false));
    talon
        .set_feedback_device(FeedbackDevice::Quadrature)
        .unwrap();
    bench.poke(0, Poke::Stall(true));
    bench.run(300);
    talon.set_position(0).unwrap();
    bench.run(30);
    assert_eq!(drives(&bench, &talon), (true, true));
}

#[test]
fn row_99_normally_closed_acts_under_an_override_at_once_unlike_firmware_1_1() {
    // Manual 21.6 is a limitation of firmware 1.1 that is not reproduced (docs/talon-srx-rows.md).
    let (bench, talon) = TalonBench::enabled();
    talon.enable_limit_switch(true, true).unwrap();
    talon.config_fwd_limit_switch_normally_open(false).unwrap();
    bench.run(200);
    assert_eq!(drives(&bench, &talon), (false, true));
    assert_eq!(talon.control_mode(), ControlMode::PercentVbus);
}
