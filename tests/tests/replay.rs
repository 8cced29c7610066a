//! I10: the same log replayed gives the same actuation stream, bit for bit.

use windlass_core::dialect::DialectKind;
use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_core::engine::Board;
use windlass_core::engine::command::{Command, Setpoint};
use windlass_core::engine::snapshot::{Pin, Sample};
use windlass_core::params::table::TABLE;
use windlass_core::params::{Params, compile};
use windlass_core::units::{Amps, Duty, Volts};
use windlass_sim::{Poke, TickRecord, World, WorldConfig, replay};
use windlass_tests::{Bench, control, fixed};

const DEVICE: u8 = 5;

/// Goes through every mode, faults and limits.
fn scenario() -> Bench {
    let mut world = World::new(WorldConfig::default());
    for number in [DEVICE, 9] {
        world.add_node(format!("dmc60c:{number}").parse().expect("a good number"));
    }
    world.node_mut(0).expect("the node").record_ticks();
    let mut bench = Bench::around(world);
    bench.set(
        DEVICE,
        &[
            (10, fixed(2.0)),
            (11, fixed(0.01)),
            (12, fixed(40.0)),
            (14, fixed(0.3)),
            (64, 1),
            (63, 20),
            (16, 900),
        ],
    );
    let frames = [
        control(ModeSelect::Voltage, 20_000),
        control(ModeSelect::Velocity, -15_000),
        Control0 {
            reverse_motor: true,
            reverse_sensor: true,
            ..control(ModeSelect::Position, 9_000)
        },
        control(ModeSelect::Current, 15 << 16),
        Control0 {
            ramp: 77,
            ..control(ModeSelect::VoltageCompensation, 7 << 16)
        },
        control(ModeSelect::Follower, 9),
        Control0 {
            override_neutral: true,
            ..control(ModeSelect::NoDrive, 0)
        },
    ];
    for (round, frame) in frames.iter().cycle().take(21).enumerate() {
        match round {
            7 => bench.poke(0, Poke::Stall(true)),
            9 => bench.poke(0, Poke::ForwardLimitClosed(true)),
            11 => bench.poke(0, Poke::BatteryVolts(Some(9.0))),
            13 => bench.poke(0, Poke::Stall(false)),
            15 => bench.poke(0, Poke::GateDriverFault(true)),
            16 => bench.poke(0, Poke::GateDriverFault(false)),
            18 => bench.poke(0, Poke::TemperatureCelsius(Some(96.0))),
            _ => {}
        }
        bench.drive(9, &control(ModeSelect::Voltage, 3_000 * round as i32), 10);
        bench.drive(DEVICE, frame, 400);
    }
    bench
}

#[test]
fn i10_a_recorded_log_replays_to_the_same_stream_and_a_changed_one_does_not() {
    let mut bench = scenario();
    let records = bench.world.node_mut(0).expect("the node").take_ticks();
    assert!(records.len() > 16_000);
    assert_eq!(replay(&records), bench.world.actuation_hash(0));
    let mut changed = records.clone();
    changed[100].sample.encoder ^= 1;
    assert_ne!(replay(&records), replay(&changed));
}

/// Samples and commands from a generator, not from a plant, whose floating point could differ from one
/// machine to the next.
fn synthetic_trace(ticks: usize) -> Vec<TickRecord> {
    let mut random = 0x2545_F491_u32;
    let mut next = move || {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        random
    };
    let policy = DialectKind::Dmc60c.policy();
    // The rows that this dialect's drive depends on: rows that others add change nothing here.
    let rows: Vec<_> = TABLE.iter().filter(|row| row.id.code() < 130).collect();
    let mut params = Params::new();
    let mut settings = compile::settings(&params, &Board::REFERENCE, &policy);
    let mut command = Command::default();
    let mut sample = Sample {
        current: 2048,
        bus_voltage: 1354,
        temperature: 931,
        ..Sample::default()
    };
    let record = |tick: usize| {
        if tick > 64 {
            sample.encoder = sample.encoder.wrapping_add(next() % 64).wrapping_sub(20);
            sample.current = 1900 + (next() % 300) as u16;
            sample.bus_voltage = 1000 + (next() % 500) as u16;
            sample
                .pins
                .set(Pin::ForwardLimit, !next().is_multiple_of(50));
            sample
                .pins
                .set(Pin::ReverseLimit, !next().is_multiple_of(50));
            sample
                .pins
                .set(Pin::GateDriverFault, next().is_multiple_of(20_000));
            sample.temperature = if next().is_multiple_of(100) {
                1700
            } else {
                931
            };
        }
        if tick.is_multiple_of(40) && !next().is_multiple_of(8) {
            command.revision += 1;
            command.sequence += 1;
            let value = next();
            command.setpoint = match next() % 7 {
                0 => Setpoint::Duty(Duty::new(value as i16)),
                1 => Setpoint::Velocity(value as i32 >> 16),
                2 => Setpoint::Position(value as i32 >> 10),
                3 => Setpoint::Current(Amps::from_bits(value as i32 >> 10)),
                4 => Setpoint::Voltage(Volts::from_bits(value as i32 >> 11)),
                5 => Setpoint::Follow(3),
                _ => Setpoint::Off,
            };
            command.opts.ramp = if next().is_multiple_of(2) {
                0
            } else {
                next() as u16 >> 4
            };
            command.opts.reverse_motor = next().is_multiple_of(3);
            command.opts.reverse_sensor = next().is_multiple_of(3);
            command.master.duty = Duty::new(next() as i16);
            command.master.sequence += next() % 2;
        }
        if tick.is_multiple_of(500) {
            let row = &rows[next() as usize % rows.len()];
            let _ = params.set(row.id, next() >> (next() % 32));
            settings = compile::settings(&params, &Board::REFERENCE, &policy);
        }
        TickRecord {
            fresh: tick == 0,
            settings,
            sample,
            command,
        }
    };
    (0..ticks).map(record).collect()
}

/// Debug and release builds, and every machine, are compared with this and so with one another. It changes
/// only when the arithmetic of the engine, the table of parameters or the generator above change.
const EXPECTED: u64 = 0x499d_c930_9bd4_4b3e;

#[test]
fn i10_every_build_gives_the_same_actuation_stream() {
    assert_eq!(
        format!("{:016x}", replay(&synthetic_trace(100_000))),
        format!("{EXPECTED:016x}")
    );
}
