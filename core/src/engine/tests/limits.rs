//! Limits, nominal and peak duty cycle.

use super::*;

#[test]
fn a_hard_limit_blocks_only_its_direction_at_the_terminals() {
    for reverse_motor in [false, true] {
        let mut rig = Rig::new();
        rig.command.opts.reverse_motor = reverse_motor;
        let sign = if reverse_motor { -1 } else { 1 };
        rig.sample.pins.set(Pin::ForwardLimit, false);
        assert_eq!(rig.drive(Setpoint::Duty(Duty::new(sign * 1000)), 2), 0);
        assert!(rig.snapshot.limits.refused.forward());
        assert_eq!(rig.drive(Setpoint::Duty(Duty::new(sign * -1000)), 2), -1000);
        rig.sample.pins.set(Pin::ForwardLimit, true);
        rig.sample.pins.set(Pin::ReverseLimit, false);
        assert_eq!(rig.drive(Setpoint::Duty(Duty::new(sign * -1000)), 2), 0);
        assert_eq!(rig.drive(Setpoint::Duty(Duty::new(sign * 1000)), 2), 1000);
    }
}

#[test]
fn a_disabled_or_overridden_switch_reports_its_hit_and_lets_drive() {
    let mut rig = Rig::new();
    rig.sample.pins.set(Pin::ForwardLimit, false);
    rig.set(ParameterId::ForwardLimitDisabled, 1);
    assert_eq!(rig.drive(Setpoint::Duty(Duty::new(1000)), 2), 1000);
    assert!(rig.snapshot.limits.switch_hit.forward());
    rig.command.opts.limits = LimitOverride {
        enabled: true,
        ..LimitOverride::default()
    };
    assert_eq!(
        rig.drive(Setpoint::Duty(Duty::new(1000)), 2),
        0,
        "override enables the switch"
    );
    rig.set(ParameterId::ForwardLimitDisabled, 0);
    rig.command.opts.limits.disabled = Directions::FORWARD;
    assert_eq!(
        rig.drive(Setpoint::Duty(Duty::new(1000)), 2),
        1000,
        "override disables the switch"
    );
}

#[test]
fn soft_limits_act_at_the_threshold_and_only_when_enabled() {
    let mut rig = Rig::new();
    rig.set(ParameterId::SoftForwardThreshold, 100)
        .set(ParameterId::SoftReverseThreshold, -100);
    let (forward, reverse) = (
        Setpoint::Duty(Duty::new(1000)),
        Setpoint::Duty(Duty::new(-1000)),
    );
    rig.encoder(5000);
    assert_eq!(rig.drive(forward, 1), 1000, "disabled");
    rig.set(ParameterId::SoftForwardEnable, 1)
        .set(ParameterId::SoftReverseEnable, 1);
    for (position, forward_drives, reverse_drives) in [
        (99, true, true),
        (100, false, true),
        (101, false, true),
        (-99, true, true),
        (-100, true, false),
    ] {
        rig.encoder(position);
        assert_eq!(
            rig.drive(forward, 1) != 0,
            forward_drives,
            "forward at {position}"
        );
        assert_eq!(
            rig.drive(reverse, 1) != 0,
            reverse_drives,
            "reverse at {position}"
        );
    }
}

#[test]
fn a_released_limit_resumes_on_the_ramp() {
    let mut rig = Rig::new();
    rig.command.opts.ramp = 500;
    rig.sample.pins.set(Pin::ForwardLimit, false);
    assert_eq!(rig.drive(Setpoint::Duty(Duty::MAX), 50), 0);
    rig.sample.pins.set(Pin::ForwardLimit, true);
    assert_eq!(rig.drive(Setpoint::Duty(Duty::MAX), 1), 500);
}

#[test]
fn maximum_and_nominal_duty_of_the_slot() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16)
        .set(ParameterId::Slot0ForwardMax, 20_000)
        .set(ParameterId::Slot0ReverseMax, -10_000)
        .set(ParameterId::Slot0ForwardNominal, 3_000)
        .set(ParameterId::Slot0ReverseNominal, -2_000)
        .set(ParameterId::Slot0AllowableError, 50);
    let at = |rig: &mut Rig, target| rig.drive(Setpoint::Position(target), 1);
    assert_eq!(at(&mut rig, 30_000), 20_000);
    assert_eq!(at(&mut rig, -30_000), -10_000);
    assert_eq!(at(&mut rig, 51), 3_000);
    assert_eq!(at(&mut rig, -51), -2_000);
    assert_eq!(
        at(&mut rig, 49),
        0,
        "inside the allowable error nothing is raised"
    );
    assert_eq!(at(&mut rig, 5_000), 5_000);
    // Nominal and maximum are for closed loops.
    assert_eq!(rig.drive(Setpoint::Duty(Duty::new(100)), 1), 100);
    assert_eq!(rig.drive(Setpoint::Duty(Duty::MAX), 1), 32767);
}

#[test]
fn the_nominal_duty_does_not_hold_a_ramp_on_the_wrong_side() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16)
        .set(ParameterId::Slot0ForwardNominal, 3_000)
        .set(ParameterId::Slot0ReverseNominal, -3_000)
        .set(ParameterId::Slot0Ramp, 100);
    rig.drive(Setpoint::Position(-10_000), 200);
    assert_eq!(rig.drive(Setpoint::Position(10_000), 500), 10_000);
}

#[test]
fn a_slot_switch_takes_effect_at_the_next_tick() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16)
        .set(ParameterId::Slot1P, 2 << 16);
    assert_eq!(rig.drive(Setpoint::Position(100), 1), 100);
    rig.command.opts.slot = Slot::One;
    assert_eq!(rig.drive(Setpoint::Position(100), 1), 200);
    rig.set(ParameterId::Slot1P, 3 << 16);
    assert_eq!(rig.drive(Setpoint::Position(100), 1), 300);
}

#[test]
fn the_accumulator_is_cleared_by_a_change_of_mode_and_by_halting() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0I, 1 << 16);
    assert_eq!(rig.drive(Setpoint::Position(10), 5), 50);
    assert_eq!(rig.drive(Setpoint::Velocity(10), 1), 10);
    assert_eq!(rig.drive(Setpoint::Velocity(10), 1), 20);
    rig.send(Setpoint::Off).tick();
    assert_eq!(rig.drive(Setpoint::Velocity(10), 1), 10);
}

#[test]
fn reported_error_has_the_unit_of_its_mode() {
    let mut rig = Rig::new();
    rig.set(ParameterId::Slot0P, 1 << 16);
    rig.encoder(-7);
    rig.drive(Setpoint::Position(100), 1);
    assert_eq!(rig.snapshot.error, 107);
    rig.command.opts.ramp = 10;
    rig.send(Setpoint::Off).tick();
    rig.drive(Setpoint::Duty(Duty::new(100)), 2);
    assert_eq!(rig.snapshot.error, 80);
    rig.amperes(0.0);
    rig.drive(Setpoint::Current(Amps::from_num(2)), 1);
    assert_eq!(rig.snapshot.error, 2 << 16);
    rig.command.opts.ramp = 0;
    rig.drive(Setpoint::Voltage(Volts::from_num(6)), 2);
    assert!(rig.snapshot.error.abs() < 1 << 10, "{}", rig.snapshot.error);
    rig.drive(Setpoint::Follow(1), 1);
    assert_eq!(rig.snapshot.error, 0);
}
