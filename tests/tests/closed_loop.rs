//! Closed loops on the default plant, judged by the plant's truth and not by what the controller reports.
//! Gains are those of docs/tuning.md.

use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_sim::Poke;
use windlass_tests::{Bench, control, fixed};

const DEVICE: u8 = 5;
const VELOCITY_GAINS: [(u8, f64); 3] = [(10, 0.25), (11, 0.003), (14, 0.86)];
const VELOCITY_LIMITS: [(u8, u32); 2] = [(13, 200_000), (16, 200)];
const POSITION_GAINS: [(u8, f64); 2] = [(21, 2.0), (23, 130.0)];
const POSITION_LIMITS: [(u8, u32); 6] = [
    (26, 2),
    (27, 400),
    (28, 12_000),
    (29, -12_000_i32 as u32),
    (30, 600),
    (31, -600_i32 as u32),
];

fn set_fixed(bench: &mut Bench, gains: &[(u8, f64)]) {
    let values: Vec<_> = gains.iter().map(|(id, gain)| (*id, fixed(*gain))).collect();
    bench.set(DEVICE, &values);
}

/// Milliseconds after which the measured values stay within `tolerance` of `target`.
fn settling_time(values: &[f64], target: f64, tolerance: f64) -> usize {
    let outside = values
        .iter()
        .rposition(|value| (value - target).abs() > tolerance);
    outside.map_or(0, |at| at + 1) * 10
}

fn follow_target(
    bench: &mut Bench,
    frame: &Control0,
    steps: usize,
    value: fn(&Bench) -> f64,
) -> Vec<f64> {
    (0..steps)
        .map(|_| {
            bench.drive(DEVICE, frame, 10);
            value(bench)
        })
        .collect()
}

#[test]
fn velocity_steps_settle_within_3_percent_in_under_500_ms() {
    for target in [5_000, 20_000, 30_000, -10_000] {
        let mut bench = Bench::new(&[DEVICE]);
        set_fixed(&mut bench, &VELOCITY_GAINS);
        bench.set(DEVICE, &VELOCITY_LIMITS);
        let frame = control(ModeSelect::Velocity, target);
        let seen = follow_target(&mut bench, &frame, 150, |b| {
            b.truth(0).velocity_counts_per_100ms
        });
        let target = f64::from(target);
        let settled = settling_time(&seen, target, target.abs() * 0.03);
        assert!(settled < 500, "{target}: {settled} ms");
    }
}

#[test]
fn position_moves_end_within_2_counts() {
    for target in [4_096, 40_960, -8_192, 100] {
        let mut bench = Bench::new(&[DEVICE]);
        set_fixed(&mut bench, &POSITION_GAINS);
        bench.set(DEVICE, &POSITION_LIMITS);
        let frame = Control0 {
            slot_1: true,
            ..control(ModeSelect::Position, target)
        };
        let seen = follow_target(&mut bench, &frame, 200, |b| {
            b.truth(0).position_counts as f64
        });
        let settled = settling_time(&seen, f64::from(target), 2.0);
        assert!(settled < 1_000, "{target}: {settled} ms");
    }
}

#[test]
fn current_is_held_within_5_percent_on_a_stalled_and_on_a_loaded_motor() {
    for (stall, amperes) in [(true, 20.0), (true, -35.0), (false, 30.0)] {
        let mut bench = Bench::new(&[DEVICE]);
        bench.poke(0, Poke::Stall(stall));
        if !stall {
            // Torque that needs about 30 A keeps the loaded motor from running away.
            bench.poke(0, Poke::LoadNewtonMetres(0.5));
        }
        set_fixed(&mut bench, &[(10, 50.0), (11, 20.0)]);
        let frame = control(ModeSelect::Current, fixed(amperes) as i32);
        let seen = follow_target(&mut bench, &frame, 30, |b| b.truth(0).current_a);
        let settled = settling_time(&seen, amperes, amperes.abs() * 0.05);
        assert!(
            settled < 200,
            "{amperes} A, stalled {stall}: {settled} ms of {seen:?}"
        );
    }
}

#[test]
fn voltage_compensation_holds_the_output_within_2_percent_while_the_battery_sags() {
    let mut bench = Bench::new(&[DEVICE]);
    let frame = control(ModeSelect::VoltageCompensation, fixed(6.0) as i32);
    bench.drive(DEVICE, &frame, 500);
    for battery in [12.7, 11.0, 9.5, 8.0, 12.7] {
        bench.poke(0, Poke::BatteryVolts(Some(battery)));
        bench.drive(DEVICE, &frame, 200);
        let truth = bench.truth(0);
        let output = truth.bus_v * f64::from(truth.duty) / 32768.0;
        assert!(
            (output - 6.0).abs() < 0.12,
            "battery {battery} V: output {output} V"
        );
    }
}

#[test]
fn a_follower_tracks_its_master_within_one_status_period() {
    let mut bench = Bench::new(&[DEVICE, 9]);
    let follow = Control0 {
        target: i32::from(DEVICE),
        ..control(ModeSelect::Follower, 0)
    };
    for duty in [8_000, -12_000, 30_000, 500] {
        for _ in 0..30 {
            bench
                .world
                .send(bench.tool, control(ModeSelect::Voltage, duty).emit(DEVICE));
            bench.world.send(bench.tool, follow.emit(9));
            bench.run(windlass_tests::ms(10));
        }
        assert_eq!(bench.truth(0).duty, duty as i16);
        assert_eq!(bench.truth(1).duty, duty as i16);
    }
    // A step of the master is copied after one period of its general status at the latest.
    bench.world.send(
        bench.tool,
        control(ModeSelect::Voltage, -4_321).emit(DEVICE),
    );
    bench.world.send(bench.tool, follow.emit(9));
    bench.run(windlass_tests::ms(12));
    assert_eq!(bench.truth(1).duty, -4_321);
}

#[test]
fn current_limiting_holds_a_stalled_motor_at_its_continuous_limit() {
    for sign in [1, -1] {
        let mut bench = Bench::new(&[DEVICE]);
        bench.set(DEVICE, &[(64, 1)]);
        bench.poke(0, Poke::Stall(true));
        let frame = control(ModeSelect::Voltage, sign * 20_000);
        bench.drive(DEVICE, &frame, 490);
        assert!(
            bench.truth(0).current_a.abs() > 60.0,
            "the peak is allowed for 500 ms"
        );
        assert!(!bench.general(DEVICE).current_limited);
        bench.drive(DEVICE, &frame, 60);
        let seen = follow_target(&mut bench, &frame, 100, |b| b.truth(0).current_a);
        let target = 40.0 * f64::from(sign);
        assert!(
            seen.iter().all(|current| (current - target).abs() < 2.0),
            "{seen:?}"
        );
        assert!(bench.general(DEVICE).current_limited);
    }
}

#[test]
fn feed_forward_of_the_guide_gives_half_throttle_at_20_amperes() {
    // Guide, paramClosedLoopFGainSlot0: 0x03332CCC.
    let mut bench = Bench::new(&[DEVICE]);
    bench.set(DEVICE, &[(14, 0x0333_2CCC)]);
    bench.drive(DEVICE, &control(ModeSelect::Current, 20 << 16), 50);
    assert_eq!(bench.truth(0).duty, 16_383);
}
