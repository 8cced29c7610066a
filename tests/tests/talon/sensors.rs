//! Sensors, selection, reversal, set position, units (rows 39, 40, 42, 59 to 61, 71, 72, 78, 83 to 86).

use windlass_core::dialect::talon_srx::wire::{FeedbackDevice, General, Parameter};
use windlass_sim::Poke;

use crate::bench::{Bench, duty};

#[test]
fn raw_signals_are_always_there_and_only_the_selected_one_is_reversed() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.poke(0, Poke::AnalogVolts(Some(1.65)));
    let told = |feedback, reverse_sensor| General {
        feedback,
        reverse_sensor,
        ..duty(300)
    };
    bench.drive(3, told(FeedbackDevice::Quadrature, false), 1000);
    bench.poke(0, Poke::Stall(true));
    bench.run(200);
    let encoder = bench.status_3(3).position;
    let analog = bench.status_4(3).position;
    assert!(
        encoder > 1000 && (511..=513).contains(&analog),
        "{encoder} {analog}"
    );
    for (feedback, expected) in [
        (FeedbackDevice::Quadrature, encoder),
        (FeedbackDevice::AnalogPotentiometer, analog),
        (FeedbackDevice::AnalogEncoder, analog),
        (FeedbackDevice::Unsupported(5), 0),
    ] {
        for (reversed, sign) in [(false, 1), (true, -1)] {
            bench.control(3, told(feedback, reversed));
            bench.run(2);
            assert_eq!(
                bench.status_2(3).position,
                sign * expected,
                "{feedback:?} {reversed}"
            );
            assert_eq!(bench.status_3(3).position, encoder, "raw");
            assert_eq!(bench.status_4(3).position, analog, "raw");
        }
    }
}

#[test]
fn velocity_is_counts_per_100_ms_and_the_edge_counter_counts_a_quarter() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.drive(3, duty(200), 1500);
    bench.control(3, duty(200));
    let quadrature = f64::from(bench.status_2(3).velocity);
    let truth = bench.truth(0).velocity_counts_per_100ms;
    assert!(
        (quadrature - truth).abs() < truth / 50.0,
        "{quadrature} {truth}"
    );
    let told = General {
        feedback: FeedbackDevice::RisingEdges,
        ..duty(200)
    };
    bench.drive(3, told, 500);
    bench.control(3, told);
    let edges = bench.status_2(3);
    assert!(
        (f64::from(edges.velocity) * 4.0 - truth).abs() < truth / 20.0,
        "{}",
        edges.velocity
    );
    bench.drive(
        3,
        General {
            feedback: FeedbackDevice::RisingEdges,
            ..duty(-200)
        },
        1500,
    );
    assert!(
        bench.status_2(3).position > edges.position,
        "never decrements"
    );
}

#[test]
fn the_analog_input_wraps_as_encoder_and_not_as_potentiometer() {
    let mut bench = Bench::new(&["talon:3"]);
    let mut expected = None;
    let volts = |steps: i32| Some((f64::from(steps.rem_euclid(1024)) + 0.5) * 3.3 / 1024.0);
    for steps in (500..1100)
        .step_by(20)
        .chain((-100..1100).rev().step_by(20))
    {
        bench.poke(0, Poke::AnalogVolts(volts(steps)));
        bench.run(2);
        expected = Some(steps);
    }
    assert_eq!(bench.status_4(3).position, expected.unwrap_or(0));
    let told = General {
        feedback: FeedbackDevice::AnalogPotentiometer,
        ..duty(0)
    };
    bench.control(3, told);
    bench.run(2);
    let raw = bench.status_4(3).position;
    assert!(raw < 0, "{raw}");
    assert_eq!(bench.status_2(3).position, raw & 0x3FF, "manual 16.18");
}

#[test]
fn set_position_acts_on_the_selected_sensor_by_its_rule() {
    let mut bench = Bench::new(&["talon:3"]);
    bench.poke(0, Poke::Stall(true));
    bench.poke(0, Poke::AnalogVolts(Some(1.0)));
    bench.run(150);
    let adc = bench.status_4(3).position;
    assert!((309..=311).contains(&adc), "{adc}");
    let mut set = |feedback, value: i32| {
        bench.control(
            3,
            General {
                feedback,
                ..duty(0)
            },
        );
        bench.run(2);
        let answer = bench.set(3, Parameter::SensorPosition, value as u32);
        (answer.map(|raw| raw as i32), bench.status_2(3).position)
    };
    assert_eq!(set(FeedbackDevice::Quadrature, -77), (Some(-77), -77));
    assert_eq!(set(FeedbackDevice::RisingEdges, 1000), (Some(1000), 1000));
    assert_eq!(
        set(FeedbackDevice::AnalogPotentiometer, 5),
        (Some(adc), adc)
    );
    assert_eq!(set(FeedbackDevice::AnalogEncoder, 2048).1, 2048 + adc);
    assert_eq!(bench.status_3(3).position, -77);
    bench.set(3, Parameter::EncoderPosition, 12);
    assert_eq!(bench.status_3(3).position, 12);
}
