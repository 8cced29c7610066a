//! x86-64 instructions of the core's hot paths, counted by callgrind: repeatable, whatever else the machine
//! does. `docs/performance.md` tells how to run it.

// The macros make public items without documentation.
#![allow(missing_docs)]

use std::hint::black_box;

use gungraun::{library_benchmark, library_benchmark_group, main};
use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_core::engine::Engine;
use windlass_core::engine::pidf::{Gains, Pidf, Unit};
use windlass_core::engine::snapshot::{Sample, Snapshot};
use windlass_core::frame::Frame;
use windlass_core::node::{Node, NodeConfig};
use windlass_core::params::Stored;
use windlass_core::params::table::ParameterId;
use windlass_core::time::{Duration, Instant, TICK};

struct Rig {
    node: Node,
    engine: Engine,
    sample: Sample,
    snapshot: Snapshot,
    now: Instant,
}

/// A controller that has been driving in `mode` for 100 ms, with all gains, ramp and current limiting on.
fn rig(mode: ModeSelect) -> Box<Rig> {
    let mut stored = Stored {
        number: 5,
        ..Stored::default()
    };
    for (id, value) in [
        (ParameterId::Slot0P, 2 << 16),
        (ParameterId::Slot0I, 300),
        (ParameterId::Slot0D, 9 << 16),
        (ParameterId::Slot0F, 30_000),
        (ParameterId::Slot0IZone, 100_000),
        (ParameterId::Slot0AllowableError, 3),
        (ParameterId::Slot0Ramp, 500),
        (ParameterId::Slot0ForwardNominal, 700),
        (ParameterId::CurrentLimitEnable, 1),
        (ParameterId::PeakDuration, 0),
    ] {
        stored.params.set(id, value).expect("an allowed value");
    }
    let mut rig = Box::new(Rig {
        node: Node::new(Instant::ZERO, &NodeConfig::dmc60c(1), Some(&stored)),
        engine: Engine::new(),
        sample: Sample {
            current: 2048,
            bus_voltage: 1354,
            temperature: 931,
            ..Sample::default()
        },
        snapshot: Snapshot::default(),
        now: Instant::ZERO,
    });
    for step in 0..300_u32 {
        if step == 100 {
            let control = Control0 {
                mode,
                target: 5_000,
                ramp: 100,
                ..Control0::default()
            };
            rig.node.on_frame(rig.now, &control.emit(5), &rig.snapshot);
        }
        rig.sample.encoder = rig.sample.encoder.wrapping_add(11);
        // 61 A: above the peak limit, so that the limiter works.
        rig.sample.current = if step > 100 { 3978 } else { 2048 };
        rig.now = rig.now + TICK;
        let (settings, command) = (*rig.node.settings(), *rig.node.command());
        rig.snapshot = *rig.engine.tick(&settings, &rig.sample, &command);
        rig.node.poll(rig.now, &rig.snapshot);
        while rig.node.poll_tx(rig.now, &rig.snapshot).is_some() {}
    }
    rig
}

#[library_benchmark]
#[bench::off(rig(ModeSelect::NoDrive))]
#[bench::voltage(rig(ModeSelect::Voltage))]
#[bench::velocity(rig(ModeSelect::Velocity))]
#[bench::position(rig(ModeSelect::Position))]
#[bench::current(rig(ModeSelect::Current))]
#[bench::voltage_compensation(rig(ModeSelect::VoltageCompensation))]
fn engine_tick(mut rig: Box<Rig>) -> Box<Rig> {
    let (settings, command) = (rig.node.settings(), rig.node.command());
    rig.snapshot = *black_box(rig.engine.tick(settings, &rig.sample, command));
    rig
}

#[library_benchmark]
#[bench::all_terms(Box::new(Pidf::new()))]
fn pidf_step(mut law: Box<Pidf>) -> (Box<Pidf>, i32) {
    let gains = Gains {
        p: 1 << 16,
        i: 100,
        d: 1 << 18,
        f: 9_000,
        accumulator_limit: 5_000,
        allowable_error: 2,
    };
    let output = law.step(
        black_box(&gains),
        black_box(5_000),
        black_box(300),
        Unit::Count,
    );
    (law, output)
}

fn with(frame: Frame) -> (Box<Rig>, Frame) {
    (rig(ModeSelect::Voltage), frame)
}

#[library_benchmark]
#[bench::control(with(Control0 { mode: ModeSelect::Velocity, target: 77, ..Control0::default() }.emit(5)))]
#[bench::foreign(with(Frame::extended(0x0205_1403, [0; 8])))]
fn receive_frame((mut rig, frame): (Box<Rig>, Frame)) -> Box<Rig> {
    let (now, snapshot) = (rig.now, rig.snapshot);
    rig.node.on_frame(now, black_box(&frame), &snapshot);
    rig
}

#[library_benchmark]
#[bench::due(rig(ModeSelect::Voltage))]
fn status_frame(mut rig: Box<Rig>) -> (Box<Rig>, bool) {
    let later = rig.now + Duration::from_millis(10);
    let sent = rig.node.poll_tx(black_box(later), &rig.snapshot).is_some();
    (rig, sent)
}

library_benchmark_group!(
    name = core_paths;
    benchmarks = engine_tick, pidf_step, receive_frame, status_frame
);

main!(library_benchmark_groups = core_paths);
