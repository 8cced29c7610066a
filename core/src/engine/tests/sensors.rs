//! Encoder and analog inputs.

use super::*;

#[test]
fn position_counts_from_power_on_and_wraps() {
    let mut rig = Rig::cold();
    rig.sample.encoder = u32::MAX - 10;
    rig.tick();
    assert_eq!(rig.snapshot.position, 0);
    rig.sample.encoder = 20;
    rig.tick();
    assert_eq!(rig.snapshot.position, 31);
    rig.command.set_position = SetPosition {
        counts: i32::MAX,
        generation: 1,
        ..SetPosition::default()
    };
    rig.tick();
    rig.sample.encoder = 21;
    rig.tick();
    assert_eq!(rig.snapshot.position, i32::MIN);
}

#[test]
fn velocity_is_the_difference_over_200_ticks() {
    let mut rig = Rig::new();
    for tick in 1..=400 {
        rig.encoder(tick * 3).tick();
    }
    assert_eq!(rig.snapshot.velocity, 600);
    // Setting the position does not disturb it.
    rig.command.set_position = SetPosition {
        counts: -5000,
        generation: 1,
        ..SetPosition::default()
    };
    rig.encoder(1203).tick();
    assert_eq!((rig.snapshot.position, rig.snapshot.velocity), (-5000, 600));
    for tick in 1..=100 {
        rig.encoder(1203).tick();
        assert_eq!(rig.snapshot.velocity, 600 - tick * 3);
    }
}

#[test]
fn sensor_reversal_negates_position_and_velocity_but_not_while_following() {
    let mut rig = Rig::new();
    rig.command.opts.reverse_sensor = true;
    rig.encoder(100).tick();
    assert_eq!((rig.snapshot.position, rig.snapshot.velocity), (-100, -100));
    rig.command.set_position = SetPosition {
        counts: 500,
        generation: 1,
        ..SetPosition::default()
    };
    rig.tick();
    assert_eq!(rig.snapshot.position, 500);
    rig.encoder(110).tick();
    assert_eq!(rig.snapshot.position, 490);
    rig.send(Setpoint::Follow(2)).tick();
    assert_eq!(rig.snapshot.position, -490);
}

#[test]
fn a_repeated_set_position_acts_once() {
    let mut rig = Rig::new();
    rig.command.set_position = SetPosition {
        counts: 7,
        generation: 1,
        ..SetPosition::default()
    };
    rig.tick();
    rig.encoder(100).tick();
    assert_eq!(rig.snapshot.position, 107);
}

#[test]
fn the_chosen_index_edge_clears_at_its_own_count() {
    let mut rig = Rig::new();
    rig.set(ParameterId::ClearPositionOnIndex, 1);
    rig.sample.index_falling = IndexCapture {
        edges: 1,
        count: 40,
    };
    rig.encoder(45).tick();
    assert_eq!(rig.snapshot.position, 5);
    rig.sample.index_rising = IndexCapture {
        edges: 1,
        count: 41,
    };
    rig.encoder(50).tick();
    assert_eq!(rig.snapshot.position, 10, "rising edges are not chosen");
    rig.set(ParameterId::IndexActiveEdge, 1).tick();
    assert_eq!(
        rig.snapshot.position, 10,
        "choosing the other edge is no edge"
    );
    rig.sample.index_rising = IndexCapture {
        edges: 2,
        count: 60,
    };
    rig.encoder(61).tick();
    assert_eq!(rig.snapshot.position, 1);
    rig.set(ParameterId::ClearPositionOnIndex, 0);
    rig.sample.index_rising = IndexCapture {
        edges: 3,
        count: 70,
    };
    rig.encoder(75).tick();
    assert_eq!(rig.snapshot.position, 15);
}

#[test]
fn an_active_limit_switch_holds_the_position_cleared_even_if_disabled() {
    for (clear, disable, forward) in [
        (
            ParameterId::ClearPositionOnForwardLimit,
            ParameterId::ForwardLimitDisabled,
            true,
        ),
        (
            ParameterId::ClearPositionOnReverseLimit,
            ParameterId::ReverseLimitDisabled,
            false,
        ),
    ] {
        let mut rig = Rig::new();
        rig.set(clear, 1).set(disable, 1);
        rig.encoder(100).tick();
        assert_eq!(rig.snapshot.position, 100);
        let pin = |rig: &mut Rig, high| {
            if forward {
                rig.sample.pins.set(Pin::ForwardLimit, high);
            } else {
                rig.sample.pins.set(Pin::ReverseLimit, high);
            }
        };
        pin(&mut rig, false);
        for count in 100..110 {
            rig.encoder(count).tick();
            assert_eq!(rig.snapshot.position, 0);
        }
        pin(&mut rig, true);
        rig.encoder(115).tick();
        assert_eq!(rig.snapshot.position, 6);
    }
}

#[test]
fn current_is_sample_minus_zero_times_multiplier() {
    // Guide, paramAdcCurrentMultiplier: 3.3 / 4096 / (500 µΩ × 50) × 65536 = 2112 = 0x840.
    let multiplier = (3.3 / 4096.0 / (0.0005 * 50.0) * 65536.0 + 0.5) as i32;
    assert_eq!(multiplier, 0x840);
    let mut rig = Rig::cold();
    rig.set(ParameterId::CurrentMultiplier, multiplier);
    rig.sample.current = 2050;
    rig.ticks(64);
    rig.sample.current = 2060;
    rig.tick();
    assert_eq!(rig.snapshot.current.to_bits(), 10 * 0x840);
    rig.sample.current = 2000;
    rig.tick();
    assert_eq!(rig.snapshot.current.to_bits(), -50 * 0x840);
}

#[test]
fn voltages_and_temperature_of_the_reference_board() {
    let mut rig = Rig::new();
    rig.sample.bus_voltage = volts(12.5);
    rig.sample.temperature = celsius(40.0);
    rig.sample.analog_in = 2048;
    rig.tick();
    let near = |value: fixed::types::I16F16, expected: f64, tolerance: f64| {
        assert!(
            (value.to_num::<f64>() - expected).abs() < tolerance,
            "{value} {expected}"
        );
    };
    near(rig.snapshot.bus_voltage, 12.5, 0.01);
    near(rig.snapshot.temperature, 40.0, 0.1);
    near(rig.snapshot.analog_in, 1.65, 0.001);
}
