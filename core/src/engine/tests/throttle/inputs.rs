//! Sensors and limits of the drive in throttle units.

use super::*;

#[test]
fn the_one_direction_sensor_never_drives_backwards_before_reversal() {
    let mut rig = rig();
    rig.set(ParameterId::ThrottleSlot0P, 1 << 22);
    rig.command.opts.sensor = SensorSelect::RisingEdges;
    rig.sample.encoder_a_rises = 50;
    assert_eq!(rig.throttle(Setpoint::Position(-100), 2), 0);
    assert_eq!(rig.throttle(Setpoint::Position(100), 2), 50);
    rig.command.opts.reverse_motor = true;
    assert_eq!(rig.throttle(Setpoint::Position(100), 2), -50);
    assert_eq!(rig.throttle(Setpoint::Position(-100), 2), 0);
}

#[test]
fn the_potentiometer_stays_in_its_range_and_the_encoder_goes_on() {
    let mut rig = rig();
    let mut read = |conversion: u16, sensor| {
        rig.command.opts.sensor = sensor;
        rig.analog(conversion).ticks(2);
        rig.snapshot.position
    };
    use SensorSelect::{AnalogEncoder, AnalogPotentiometer};
    assert_eq!(read(500, AnalogEncoder), 500);
    assert_eq!(read(1000, AnalogEncoder), 1000);
    assert_eq!(read(1023, AnalogEncoder), 1023);
    assert_eq!(read(0, AnalogEncoder), 1024, "manual 16.11");
    assert_eq!(read(0, AnalogPotentiometer), 0);
    assert_eq!(read(1023, AnalogEncoder), 1023);
    assert_eq!(read(1023, AnalogPotentiometer), 1023);
    assert_eq!(read(511, AnalogEncoder), 511, "512 steps are no wrap");
    assert_eq!(read(0, AnalogEncoder), 0);
    assert_eq!(read(1023, AnalogEncoder), -1, "manual 16.11");
}

#[test]
fn analog_and_edge_velocity_are_the_change_of_100_ms() {
    let mut rig = rig();
    // 1023 steps a second: 102 in 100 ms (manual 17.2), the wrap included.
    for tick in 0..2200_u32 {
        rig.analog(((tick / 2) * 1023 / 1000 % 1024) as u16);
        rig.sample.encoder_a_rises = (tick * 3) as u16;
        rig.command.opts.sensor = SensorSelect::AnalogEncoder;
        rig.tick();
        if tick > 400 {
            let velocity = rig.snapshot.velocity;
            assert!((102..=103).contains(&velocity), "{velocity} at {tick}");
        }
    }
    rig.command.opts.sensor = SensorSelect::RisingEdges;
    rig.tick();
    assert!(
        (600 - rig.snapshot.velocity).abs() <= 6,
        "{}",
        rig.snapshot.velocity
    );
    assert_eq!(
        rig.snapshot.raw.encoder.velocity, 0,
        "raw signals stay apart"
    );
}

#[test]
fn edges_are_counted_up_through_the_end_of_the_hardware_counter() {
    let mut rig = rig();
    rig.command.opts.sensor = SensorSelect::RisingEdges;
    let mut rises = 0_u16;
    for _ in 0..100 {
        rises = rises.wrapping_add(3000);
        rig.sample.encoder_a_rises = rises;
        rig.ticks(2);
    }
    assert_eq!(rig.snapshot.position, 300_000);
}

#[test]
fn each_sensor_sets_its_position_by_its_own_rule() {
    let mut rig = rig();
    rig.encoder(1000).analog(300);
    rig.sample.encoder_a_rises = 40;
    rig.ticks(2);
    let mut generation = 0;
    let mut set = |rig: &mut Rig, of, sensor, counts| {
        generation += 1;
        rig.command.opts.sensor = sensor;
        rig.command.set_position = SetPosition {
            of,
            counts,
            generation,
        };
        rig.tick();
        rig.snapshot.position
    };
    use PositionOf::{Encoder, Selected};
    use SensorSelect::{AnalogEncoder, AnalogPotentiometer, Quadrature, RisingEdges};
    assert_eq!(set(&mut rig, Selected, Quadrature, 77), 77);
    assert_eq!(set(&mut rig, Selected, RisingEdges, 5), 5);
    assert_eq!(set(&mut rig, Selected, AnalogPotentiometer, 5), 300);
    assert_eq!(set(&mut rig, Selected, AnalogEncoder, 5000), 4096 + 300);
    assert_eq!(set(&mut rig, Selected, AnalogEncoder, -1), -1024 + 300);
    assert_eq!(set(&mut rig, Encoder, AnalogPotentiometer, 12), 300);
    assert_eq!(rig.snapshot.raw.encoder.position, 12);
    assert_eq!(rig.snapshot.raw.analog.position, -1024 + 300);
    rig.command.opts.reverse_sensor = true;
    assert_eq!(set(&mut rig, Selected, Quadrature, 9), 9);
    assert_eq!(rig.snapshot.raw.encoder.position, -9);
    assert_eq!(rig.snapshot.velocity, -1000, "setting moves no velocity");
}

#[test]
fn a_sensor_that_is_none_reads_zero() {
    let mut rig = rig();
    rig.encoder(1000);
    rig.command.opts.sensor = SensorSelect::None;
    rig.ticks(300);
    assert_eq!((rig.snapshot.position, rig.snapshot.velocity), (0, 0));
}

#[test]
fn soft_limits_begin_beyond_the_threshold_of_the_selected_sensor() {
    let mut rig = rig();
    rig.set(ParameterId::SoftForwardThreshold, 100)
        .set(ParameterId::SoftReverseThreshold, -100)
        .set(ParameterId::SoftForwardEnable, 1)
        .set(ParameterId::SoftReverseEnable, 1);
    for (position, forward, reverse) in [
        (100, true, true),
        (101, false, true),
        (-100, true, true),
        (-101, true, false),
    ] {
        rig.encoder(position);
        assert_eq!(
            rig.throttle(duty(500), 1) != 0,
            forward,
            "forward at {position}"
        );
        assert_eq!(
            rig.throttle(duty(-500), 1) != 0,
            reverse,
            "reverse at {position}"
        );
    }
    rig.command.opts.sensor = SensorSelect::AnalogPotentiometer;
    rig.encoder(0).analog(500);
    assert_eq!(rig.throttle(duty(500), 2), 0);
    assert!(
        rig.snapshot.limits.soft_hit.forward(),
        "shown in the direction that is not driven too"
    );
    assert_eq!(rig.throttle(duty(-500), 2), -500);
    rig.set(ParameterId::SoftForwardThreshold, i32::MAX);
    assert_eq!(
        rig.throttle(duty(500), 2),
        500,
        "nothing is beyond the end of the range"
    );
}

#[test]
fn limit_switch_truth_table_of_the_manual() {
    // Manual 4.1: mode, switch open and closed, drive.
    for (closed_type, disabled, drives_open, drives_closed) in [
        (0, 0, true, false),
        (1, 0, false, true),
        (0, 1, true, true),
        (1, 1, true, true),
    ] {
        let mut rig = rig();
        rig.set(ParameterId::ForwardLimitNormallyClosed, closed_type)
            .set(ParameterId::ForwardLimitDisabled, disabled);
        for (high, drives) in [(true, drives_open), (false, drives_closed)] {
            rig.sample.pins.set(Pin::ForwardLimit, high);
            assert_eq!(rig.throttle(duty(500), 2) != 0, drives);
            assert_eq!(
                rig.throttle(duty(-500), 2),
                -500,
                "the other direction still drives"
            );
        }
    }
}

#[test]
fn a_blocked_direction_resumes_on_the_ramp() {
    let mut rig = rig();
    rig.command.opts.ramp = 50;
    rig.sample.pins.set(Pin::ForwardLimit, false);
    assert_eq!(rig.throttle(duty(1000), 200), 0);
    rig.sample.pins.set(Pin::ForwardLimit, true);
    assert!(rig.throttle(duty(1000), 20) <= 50);
}
