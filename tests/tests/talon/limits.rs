//! Limit switches, soft limits, neutral behaviour, faults (rows 22 to 23, 26 to 33, 43 to 44, 62 to 63, 81, 98).

use windlass_core::dialect::talon_srx::wire::{
    BrakeOverride, Control3, General, LimitOverride, Parameter,
};
use windlass_core::engine::command::Neutral;
use windlass_sim::Poke;

use crate::bench::{Bench, duty};

#[test]
fn a_closed_switch_stops_its_direction_and_shows_as_fault_and_pin() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.drive(3, duty(500), 30);
    bench.poke(0, Poke::ForwardLimitClosed(true));
    assert_eq!(bench.throttle(), 0);
    bench.drive(3, duty(-500), 30);
    assert_eq!(bench.throttle(), -500);
    bench.control(3, duty(-500));
    let status = bench.status_1(3);
    assert!(status.forward_closed && status.faults.forward_limit);
    assert!(!status.reverse_closed && !status.faults.reverse_limit);
    assert!(bench.status_2(3).sticky.forward_limit);
}

#[test]
fn overrides_per_direction_leave_the_stored_settings_alone() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.poke(0, Poke::ForwardLimitClosed(true));
    for (limits, drives) in [
        (LimitOverride::STORED, false),
        (LimitOverride::Stored(3), false),
        (
            LimitOverride::Forced {
                forward: false,
                reverse: false,
            },
            true,
        ),
        (
            LimitOverride::Forced {
                forward: false,
                reverse: true,
            },
            true,
        ),
        (
            LimitOverride::Forced {
                forward: true,
                reverse: false,
            },
            false,
        ),
        (LimitOverride::STORED, false),
    ] {
        let told = General {
            limits,
            ..duty(500)
        };
        bench.drive(3, told, 30);
        assert_eq!(bench.throttle() != 0, drives, "{limits:?}");
        bench.control(3, told);
        let status = bench.status_1(3);
        assert_eq!(status.limits, limits);
        assert!(status.forward_closed);
        assert_eq!(status.faults.forward_limit, !drives, "manual 16.22");
    }
    assert_eq!(bench.get(3, Parameter::OnBootForwardDisable), Some(0));
}

#[test]
fn a_new_switch_type_disables_for_100_ms_and_the_same_one_does_not() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.drive(3, duty(-500), 50);
    bench.set(3, Parameter::OnBootForwardNormallyClosed, 0);
    assert_eq!(bench.throttle(), -500, "the same type");
    bench.control(3, duty(-500));
    assert_eq!(
        bench.set(3, Parameter::OnBootForwardNormallyClosed, 1),
        Some(1)
    );
    assert_eq!(bench.throttle(), 0);
    assert!(!bench.status_1(3).token_locked, "disabled");
    bench.drive(3, duty(-500), 80);
    assert_eq!(bench.throttle(), 0);
    bench.drive(3, duty(-500), 30);
    assert_eq!(bench.throttle(), -500, "resumes");
    bench.drive(3, duty(500), 30);
    assert_eq!(bench.throttle(), 0, "an open switch of the closed type");
    bench.set(3, Parameter::Slot0P, 5);
    bench.drive(3, duty(-500), 10);
    assert_eq!(bench.throttle(), -500, "no other setting touches the drive");
}

#[test]
fn soft_limits_are_stored_and_act_beyond_their_threshold() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.set(3, Parameter::ForwardSoftThreshold, 3000);
    bench.set(3, Parameter::ForwardSoftEnable, 1);
    bench.run(16_000);
    bench.world.power_cycle(0);
    bench.run(100);
    assert_eq!(bench.get(3, Parameter::ForwardSoftThreshold), Some(3000));
    for _ in 0..200 {
        bench.drive(3, duty(300), 10);
        let position = bench.truth(0).position_counts;
        if position > 3010 {
            assert_eq!(bench.throttle(), 0, "at {position}");
        }
        if position < 2900 {
            assert_eq!(bench.throttle(), 300, "at {position}");
        }
    }
    assert!(bench.truth(0).position_counts > 3000);
    bench.control(3, duty(300));
    assert!(bench.status_1(3).faults.forward_soft);
    bench.drive(3, duty(-300), 20);
    assert_eq!(bench.throttle(), -300);
}

#[test]
fn brake_and_coast_by_setting_button_and_override() {
    let mut bench = Bench::new(&["talon:3"]);
    let neutral = |bench: &mut Bench, brake| {
        bench.drive(3, General { brake, ..duty(0) }, 20);
        assert_eq!(
            bench.status_2(3).brake,
            bench.truth(0).neutral == Neutral::Brake
        );
        bench.truth(0).neutral
    };
    use BrakeOverride::{Brake, Coast, Reserved, Stored};
    assert_eq!(neutral(&mut bench, Stored), Neutral::Brake, "the default");
    assert_eq!(neutral(&mut bench, Coast), Neutral::Coast);
    assert_eq!(
        bench.get(3, Parameter::OnBootBrake),
        Some(1),
        "the setting stays"
    );
    bench.poke(0, Poke::Button);
    assert_eq!(bench.get(3, Parameter::OnBootBrake), Some(0));
    assert_eq!(
        neutral(&mut bench, Brake),
        Neutral::Brake,
        "the override counts"
    );
    assert_eq!(neutral(&mut bench, Stored), Neutral::Coast);
    assert_eq!(neutral(&mut bench, Reserved), Neutral::Coast);
}

#[test]
fn voltage_and_temperature_are_shown_stick_and_stop_nothing() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.poke(0, Poke::BatteryVolts(Some(6.0)));
    bench.poke(0, Poke::TemperatureCelsius(Some(101.0)));
    bench.drive(3, duty(300), 8000);
    assert_eq!(bench.throttle(), 300);
    bench.control(3, duty(300));
    let faults = bench.status_1(3).faults;
    assert!(faults.under_voltage && faults.over_temperature && !faults.hardware);
    bench.send(
        Control3 {
            clear_sticky: true,
            ..Control3::default()
        }
        .emit(3),
    );
    bench.run(5);
    let sticky = bench.status_2(3).sticky;
    assert!(sticky.under_voltage, "still present, so set again");
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.poke(0, Poke::TemperatureCelsius(Some(25.0)));
    bench.run(100);
    let faults = bench.status_1(3).faults;
    assert!(!faults.under_voltage && !faults.over_temperature);
    let sticky = bench.status_2(3).sticky;
    assert!(
        sticky.under_voltage && sticky.over_temperature,
        "they stick"
    );
    bench.send(
        Control3 {
            clear_sticky: true,
            ..Control3::default()
        }
        .emit(3),
    );
    bench.run(5);
    assert_eq!(bench.status_2(3).sticky, Default::default());
}

#[test]
fn all_six_sticky_faults_survive_a_power_cycle() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.set(3, Parameter::ForwardSoftEnable, 1);
    bench.set(3, Parameter::ReverseSoftEnable, 1);
    bench.set(3, Parameter::ForwardSoftThreshold, -5_i32 as u32);
    bench.set(3, Parameter::ReverseSoftThreshold, 5);
    bench.poke(0, Poke::ForwardLimitClosed(true));
    bench.poke(0, Poke::ReverseLimitClosed(true));
    bench.poke(0, Poke::BatteryVolts(Some(6.0)));
    bench.poke(0, Poke::TemperatureCelsius(Some(101.0)));
    bench.run(30);
    bench.poke(0, Poke::ForwardLimitClosed(false));
    bench.poke(0, Poke::ReverseLimitClosed(false));
    bench.poke(0, Poke::BatteryVolts(Some(12.0)));
    bench.poke(0, Poke::TemperatureCelsius(Some(25.0)));
    bench.set(3, Parameter::ForwardSoftEnable, 0);
    bench.set(3, Parameter::ReverseSoftEnable, 0);
    bench.run(16_000);
    bench.world.power_cycle(0);
    bench.run(100);
    for parameter in [
        Parameter::StickyOverTemperature,
        Parameter::StickyUnderVoltage,
        Parameter::StickyForwardLimit,
        Parameter::StickyReverseLimit,
        Parameter::StickyForwardSoft,
        Parameter::StickyReverseSoft,
    ] {
        assert_eq!(bench.get(3, parameter), Some(1), "{parameter:?}");
    }
    for parameter in [Parameter::FaultForwardLimit, Parameter::FaultUnderVoltage] {
        assert_eq!(bench.get(3, parameter), Some(0), "{parameter:?}");
    }
}

#[test]
fn i3_a_failure_of_the_power_stage_switches_off_at_once() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.drive(3, duty(300), 30);
    bench.poke(0, Poke::GateDriverFault(true));
    assert_eq!(bench.throttle(), 0);
    bench.control(3, duty(300));
    assert!(bench.status_1(3).faults.hardware);
}
