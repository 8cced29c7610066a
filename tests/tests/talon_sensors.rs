//! Talon SRX: sensors, their units, selection, reversal and position. The numbers are the rows of
//! docs/talon-srx-rows.md.

use windlass::client::talon::{ControlMode, StatusFrame};
use windlass_core::dialect::talon_srx::wire::{FeedbackDevice, Parameter};
use windlass_sim::Poke;
use windlass_tests::talon::{Talon, TalonBench};

/// Selects a sensor and gives the frames time.
fn select(bench: &TalonBench, talon: &Talon, device: FeedbackDevice) {
    talon.set_feedback_device(device).unwrap();
    bench.run(150);
}

/// Voltage in the middle of the step of a conversion.
fn volts(adc: i32) -> f64 {
    (f64::from(adc) + 0.5) * 3.3 / 1024.0
}

/// Moves the analog input over `counts` (one a millisecond step of `step`), wrapping at its ends.
fn sweep(bench: &TalonBench, from: i32, step: i32, steps: i32) {
    for at in 1..=steps {
        let adc = (from + at * step).rem_euclid(1024);
        bench.poke(0, Poke::AnalogVolts(Some(volts(adc))));
        bench.run(1);
    }
}

#[test]
fn row_38_the_quadrature_encoder_is_selected_by_default() {
    let (bench, talon) = TalonBench::enabled();
    assert_eq!(
        talon.feedback_device().fresh().unwrap(),
        FeedbackDevice::Quadrature
    );
    talon.set(0.2).unwrap();
    bench.run(500);
    talon.set(0.0).unwrap();
    bench.run(2000);
    let (selected, raw) = (
        talon.position().fresh().unwrap(),
        talon.enc_position().fresh().unwrap(),
    );
    assert!(raw > 1000 && selected == raw, "{selected} {raw}");
}

#[test]
fn row_39_row_40_the_selected_sensor_is_turned_and_the_raw_signals_are_not() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(volts(300))));
    talon.set(0.2).unwrap();
    bench.run(2000);
    let (raw, analog) = (
        talon.enc_vel().fresh().unwrap(),
        talon.analog_in().fresh().unwrap(),
    );
    assert!(raw > 1000);
    let selected = talon.speed().fresh().unwrap();
    assert!(selected.abs_diff(raw) < 60, "{selected} {raw}");
    talon.set_sensor_direction(true).unwrap();
    bench.run(150);
    let selected = talon.speed().fresh().unwrap();
    assert!(selected.abs_diff(-raw) < 60, "{selected} {raw}");
    assert!(talon.enc_vel().fresh().unwrap() > 1000);
    assert!(talon.position().fresh().unwrap() < 0 && talon.enc_position().fresh().unwrap() > 0);
    select(&bench, &talon, FeedbackDevice::AnalogPotentiometer);
    assert_eq!(talon.position().fresh().unwrap(), -(analog & 0x3FF));
    assert_eq!(talon.analog_in().fresh().unwrap(), analog);
    talon.set_sensor_direction(false).unwrap();
    bench.run(50);
    assert_eq!(talon.position().fresh().unwrap(), analog & 0x3FF);
}

#[test]
fn row_42_row_86_rising_edges_count_up_only_and_never_drive_backwards() {
    let (bench, talon) = TalonBench::enabled();
    select(&bench, &talon, FeedbackDevice::RisingEdges);
    let before = (
        talon.position().fresh().unwrap(),
        bench.truth(0).position_counts,
    );
    talon.set(0.1).unwrap();
    bench.run(2000);
    let velocity = f64::from(talon.speed().fresh().unwrap());
    let truth = bench.truth(0).velocity_counts_per_100ms / 4.0;
    assert!(
        (velocity - truth).abs() < truth * 0.05 + 2.0,
        "{velocity} {truth}"
    );
    talon.set(0.0).unwrap();
    bench.run(3000);
    let after = (
        talon.position().fresh().unwrap(),
        bench.truth(0).position_counts,
    );
    let (edges, counts) = (after.0 - before.0, (after.1 - before.1) / 4);
    assert!((i64::from(edges) - counts).abs() <= 1, "{edges} {counts}");
    // Backwards it counts up too.
    talon.set(-0.1).unwrap();
    bench.run(1000);
    assert!(talon.position().fresh().unwrap() > after.0 + 50);
    assert!(talon.speed().fresh().unwrap() > 0);
    // A loop with it gives no negative throttle, unless its output is reversed.
    talon.set_p(10.0).unwrap();
    talon.set_control_mode(ControlMode::Speed).unwrap();
    talon.set(-500.0).unwrap();
    bench.run(50);
    assert_eq!(bench.throttle(0), 0);
    talon.reverse_output(true).unwrap();
    talon.set(5_000.0).unwrap();
    bench.run(20);
    assert!(bench.throttle(0) < 0);
}

#[test]
fn row_59_set_position_sets_the_quadrature_and_the_edge_count() {
    let (bench, talon) = TalonBench::enabled();
    for device in [FeedbackDevice::Quadrature, FeedbackDevice::RisingEdges] {
        select(&bench, &talon, device);
        for position in [0, 5000, -70_000, 0x7F_FFFF, -0x80_0000] {
            talon.set_position(position).unwrap();
            bench.run(50);
            assert_eq!(talon.position().fresh().unwrap(), position, "{device:?}");
        }
    }
    select(&bench, &talon, FeedbackDevice::Quadrature);
    talon.set_position(1234).unwrap();
    bench.run(150);
    assert_eq!(talon.enc_position().fresh().unwrap(), 1234);
}

#[test]
fn row_60_set_position_of_an_analog_encoder_keeps_the_low_ten_bits() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(volts(300))));
    select(&bench, &talon, FeedbackDevice::AnalogEncoder);
    let adc = talon.position().fresh().unwrap() & 0x3FF;
    assert!(adc.abs_diff(300) <= 2);
    for position in [0, 5 * 1024, -3 * 1024, 1000] {
        talon.set_position(position).unwrap();
        bench.run(50);
        let shown = talon.position().fresh().unwrap();
        assert_eq!(shown & !0x3FF, position & !0x3FF, "{position}");
        assert!((shown & 0x3FF).abs_diff(adc) <= 2, "{shown}");
    }
}

#[test]
fn row_61_set_position_of_a_potentiometer_has_no_effect() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(volts(700))));
    select(&bench, &talon, FeedbackDevice::AnalogPotentiometer);
    talon.set_position(5000).unwrap();
    bench.run(150);
    assert!(talon.position().fresh().unwrap().abs_diff(700) <= 2);
}

#[test]
fn row_72_wraps_are_tracked_by_the_encoder_and_not_by_the_potentiometer() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(volts(1000))));
    select(&bench, &talon, FeedbackDevice::AnalogEncoder);
    talon.set_position(0).unwrap();
    bench.run(30);
    sweep(&bench, 1000, 8, 10);
    bench.run(50);
    let up = talon.position().fresh().unwrap();
    assert!(up.abs_diff(1080) <= 3, "{up}");
    sweep(&bench, 1080, -8, 150);
    bench.run(50);
    let down = talon.position().fresh().unwrap();
    assert!(down.abs_diff(-120) <= 3, "{down}");
    select(&bench, &talon, FeedbackDevice::AnalogPotentiometer);
    let pot = talon.position().fresh().unwrap();
    assert!(pot.abs_diff(1024 - 120) <= 3, "{pot}");
}

#[test]
fn row_78_row_84_the_potentiometer_is_the_ten_bit_conversion_of_3_3_volts() {
    let (bench, talon) = TalonBench::enabled();
    select(&bench, &talon, FeedbackDevice::AnalogPotentiometer);
    for (volts, counts) in [(0.0, 0), (3.3, 1023), (1.65, 512), (0.33, 102)] {
        bench.poke(0, Poke::AnalogVolts(Some(volts)));
        bench.run(150);
        let position = talon.position().fresh().unwrap();
        assert!(position.abs_diff(counts) <= 3, "{volts} V: {position}");
        assert!((0..=1023).contains(&position));
        let raw = i32::from(talon.analog_in_raw().fresh().unwrap());
        assert!(raw.abs_diff(position) <= 2, "{raw} {position}");
    }
}

#[test]
fn row_84_row_85_a_sweep_of_1023_counts_in_a_second_is_a_velocity_of_102() {
    for device in [
        FeedbackDevice::AnalogPotentiometer,
        FeedbackDevice::AnalogEncoder,
    ] {
        let (bench, talon) = TalonBench::enabled();
        bench.poke(0, Poke::AnalogVolts(Some(volts(0))));
        select(&bench, &talon, device);
        sweep(&bench, 0, 1, 600);
        let velocity = talon.speed().fresh().unwrap();
        // One count every millisecond is 1000 in a second: 100 in 100 ms.
        assert!(velocity.abs_diff(100) <= 4, "{device:?}: {velocity}");
        let raw = talon.analog_in_vel().fresh().unwrap();
        assert!(raw.abs_diff(100) <= 4, "{raw}");
        sweep(&bench, 600, -1, 400);
        let velocity = talon.speed().fresh().unwrap();
        assert!(velocity.abs_diff(-100) <= 4, "{velocity}");
    }
}

#[test]
fn row_85_the_analog_encoder_goes_on_at_the_same_speed_past_its_end() {
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(volts(900))));
    select(&bench, &talon, FeedbackDevice::AnalogEncoder);
    sweep(&bench, 900, 4, 60);
    let velocity = talon.speed().fresh().unwrap();
    assert!(velocity.abs_diff(300) < 110, "{velocity}");
    sweep(&bench, 900 + 240, 4, 60);
    let velocity = talon.speed().fresh().unwrap();
    assert!(velocity.abs_diff(400) <= 6, "{velocity}");
}

#[test]
fn row_83_quadrature_counts_four_edges_and_its_velocity_is_per_100_ms() {
    let (bench, talon) = TalonBench::enabled();
    let before = (
        talon.enc_position().fresh().unwrap(),
        bench.truth(0).position_counts,
    );
    talon.set(0.3).unwrap();
    bench.run(3000);
    // The plant's counts are quadrature edges: a revolution is four times the encoder's cycles.
    let truth = bench.truth(0).velocity_counts_per_100ms;
    let shown = f64::from(talon.enc_vel().fresh().unwrap());
    assert!((shown - truth).abs() <= truth * 0.01, "{shown} {truth}");
    talon.set(0.0).unwrap();
    bench.run(4000);
    let after = (
        talon.enc_position().fresh().unwrap(),
        bench.truth(0).position_counts,
    );
    assert_eq!(i64::from(after.0 - before.0), after.1 - before.1);
    assert_eq!(talon.enc_vel().fresh().unwrap(), 0);
}

#[test]
fn row_35_index_rises_and_pins_are_reported() {
    let (bench, talon) = TalonBench::enabled();
    let before = talon.number_of_quad_idx_rises().fresh().unwrap();
    for _ in 0..5 {
        bench.poke(0, Poke::IndexPin(Some(false)));
        bench.run(5);
        bench.poke(0, Poke::IndexPin(Some(true)));
        bench.run(5);
    }
    bench.run(150);
    let rises = talon
        .number_of_quad_idx_rises()
        .fresh()
        .unwrap()
        .wrapping_sub(before);
    assert!((4..=5).contains(&rises), "{rises}");
    assert!(talon.quadrature_pins().fresh().unwrap().2);
    bench.poke(0, Poke::IndexPin(Some(false)));
    bench.run(150);
    assert!(!talon.quadrature_pins().fresh().unwrap().2);
    talon.set_parameter(Parameter::IndexRiseEvents, 0).unwrap();
    bench.run(150);
    assert_eq!(talon.number_of_quad_idx_rises().fresh().unwrap(), 0);
}

#[test]
fn row_71_raw_sensors_come_every_100_ms_whatever_is_selected_and_faster_if_asked() {
    use windlass_core::dialect::talon_srx::wire::id;
    let (bench, talon) = TalonBench::enabled();
    for device in [
        FeedbackDevice::Quadrature,
        FeedbackDevice::AnalogEncoder,
        FeedbackDevice::RisingEdges,
    ] {
        select(&bench, &talon, device);
        let from = bench.next_frame();
        bench.run(1000);
        let counts =
            [id::STATUS_3, id::STATUS_4, id::STATUS_2].map(|id| bench.frames(from, id, 3).len());
        assert!(
            counts[0].abs_diff(10) <= 1 && counts[1].abs_diff(10) <= 1,
            "{counts:?}"
        );
        assert!(counts[2].abs_diff(50) <= 1, "{counts:?}");
    }
    talon
        .set_status_frame_rate_ms(StatusFrame::QuadEncoder, 10)
        .unwrap();
    bench.run(10);
    let from = bench.next_frame();
    bench.run(1000);
    assert!(bench.frames(from, id::STATUS_3, 3).len().abs_diff(100) <= 1);
}

#[test]
fn row_100_units_are_always_the_device_s_own() {
    // There is no setting for encoder codes or potentiometer turns: parameters 112 and 113 do not exist.
    let (bench, _) = TalonBench::enabled();
    use windlass_core::dialect::talon_srx::wire::{ParameterRequest, id};
    for parameter in [112, 113] {
        let from = bench.next_frame();
        bench.inject(ParameterRequest { parameter }.emit(3));
        bench.run(20);
        assert!(bench.frames(from, id::PARAMETER_RESPONSE, 3).is_empty());
    }
}

#[test]
fn row_80_an_open_analog_input_reads_what_its_pin_floats_at() {
    // The hardware hovers near 100 counts; here the bench sets that voltage.
    let (bench, talon) = TalonBench::enabled();
    bench.poke(0, Poke::AnalogVolts(Some(0.32)));
    bench.run(200);
    assert!(talon.analog_in_raw().fresh().unwrap().abs_diff(100) <= 3);
}
