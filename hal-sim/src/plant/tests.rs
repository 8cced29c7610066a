use super::*;
use windlass_core::units::Duty;

fn plant() -> Plant {
    Plant::new(&PlantConfig::default(), Random::new(1, 1))
}

fn run(plant: &mut Plant, actuation: Actuation, millis: u32) {
    for _ in 0..2 * millis {
        plant.advance(actuation);
    }
}

const FULL: Actuation = Actuation::Drive(Duty::MAX);

#[test]
fn the_battery_sags_by_current_times_resistance() {
    let mut plant = plant();
    plant.set_stall(true);
    run(&mut plant, FULL, 50);
    let resistance = 0.013 + 0.002_51 + 12.0 / 131.0;
    let expected = 12.7 / resistance;
    assert!(
        (plant.current() - expected).abs() < 1.0,
        "{}",
        plant.current()
    );
    assert!((plant.bus_voltage() - (12.7 - 0.013 * expected)).abs() < 0.02);
}

#[test]
fn half_duty_takes_half_of_the_motor_current_from_the_supply() {
    let mut plant = plant();
    plant.set_stall(true);
    run(&mut plant, Actuation::Drive(Duty::new(16384)), 50);
    let sag = 12.7 - plant.bus_voltage();
    assert!((sag - 0.013 * 0.5 * plant.current()).abs() < 1e-3, "{sag}");
}

#[test]
fn reverse_mirrors_forward() {
    let (mut forward, mut reverse) = (plant(), plant());
    run(&mut forward, Actuation::Drive(Duty::new(10_000)), 300);
    run(&mut reverse, Actuation::Drive(Duty::new(-10_000)), 300);
    assert!((forward.position() + reverse.position()).abs() < 1e-6);
    assert!(forward.velocity() > 0.0);
    assert!(forward.encoder.counter() > 1000);
}

#[test]
fn free_speed_in_encoder_units() {
    // 12 V at the terminals: 5330 rpm are 36 386 counts per 100 ms.
    let mut plant = plant();
    plant.force_battery(Some(12.0));
    run(&mut plant, FULL, 1000);
    assert!(
        (plant.velocity() / 36_386.0 - 1.0).abs() < 0.01,
        "{}",
        plant.velocity()
    );
    assert!((plant.current() - 2.7).abs() < 0.03, "{}", plant.current());
}

#[test]
fn braking_draws_current_and_coasting_none() {
    let (mut brake, mut coast) = (plant(), plant());
    run(&mut brake, FULL, 500);
    run(&mut coast, FULL, 500);
    run(&mut brake, Actuation::Brake, 5);
    run(&mut coast, Actuation::Off, 5);
    assert!(brake.current() < -50.0, "{}", brake.current());
    assert!(coast.current().abs() < 1e-9);
    assert!((brake.bus_voltage() - coast.bus_voltage()).abs() < 0.01);
    run(&mut brake, Actuation::Brake, 500);
    run(&mut coast, Actuation::Off, 500);
    assert!(brake.velocity() < coast.velocity() / 100.0);
}

#[test]
fn a_short_circuit_trips_only_while_the_bridge_drives() {
    let mut plant = plant();
    plant.set_short_circuit(true);
    run(&mut plant, Actuation::Brake, 1);
    assert!(!plant.trips_gate_driver());
    assert!(plant.current().abs() < 1e-9);
    run(&mut plant, FULL, 1);
    assert!(plant.trips_gate_driver());
    assert!(plant.current() > 300.0, "{}", plant.current());
    assert!(plant.bus_voltage() < 9.0);
    run(&mut plant, Actuation::Off, 1);
    assert!(!plant.trips_gate_driver());
}

#[test]
fn a_stalled_bridge_gets_warm() {
    let mut plant = plant();
    plant.set_stall(true);
    run(&mut plant, FULL, 5000);
    // 117 A in 2.5 mΩ and 0.0016 · 11 V · 117 A: about 36 W for 5 s into 72 J/K.
    let rise = plant.temperature() - 25.0;
    assert!((2.0..3.0).contains(&rise), "{rise}");
}

#[test]
fn the_potentiometer_has_ten_turns_and_ends() {
    let mut plant = plant();
    assert!((plant.analog_in() - 1.65).abs() < 1e-9);
    plant.position = 4096.0;
    assert!((plant.analog_in() - 1.98).abs() < 1e-9);
    plant.position = 1e9;
    assert!((plant.analog_in() - 3.3).abs() < 1e-9);
    plant.force_analog(Some(0.5));
    assert_eq!(plant.convert().analog_in, 621);
}

#[test]
fn the_same_seed_gives_the_same_conversions() {
    let (mut one, mut two) = (plant(), plant());
    let mut other = Plant::new(&PlantConfig::default(), Random::new(2, 1));
    let mut differs = false;
    for _ in 0..1000 {
        one.advance(FULL);
        two.advance(FULL);
        other.advance(FULL);
        let conversions = one.convert();
        assert_eq!(conversions, two.convert());
        differs |= conversions != other.convert();
    }
    assert!(differs);
}
