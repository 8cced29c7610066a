//! Calls the core's hot paths for `cargo xtask measure`, which counts their instructions in QEMU.
//!
//! Every function that is watched stands behind a name of its own that is not inlined; what it calls is
//! inlined into it as the compiler sees fit, as in the application.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use core::hint::black_box;

use cortex_m_semihosting::debug;
use windlass_core::dialect::dmc60c::wire::id;
use windlass_core::dialect::dmc60c::{Dmc60c, status_general};
use windlass_core::dialect::talon_srx::TalonSrx;
use windlass_core::dialect::talon_srx::wire::id as talon_id;
use windlass_core::dialect::{Decoded, Device, Dialect, DialectKind, View};
use windlass_core::engine::command::{Command, Setpoint};
use windlass_core::engine::pidf::{Gains, Pidf, Unit};
use windlass_core::engine::snapshot::{Actuation, Sample, Snapshot};
use windlass_core::engine::throttle_law::{Input, ThrottleGains, ThrottleLaw};
use windlass_core::engine::{Board, Engine, Settings};
use windlass_core::frame::Frame;
use windlass_core::node::{Node, NodeConfig};
use windlass_core::params::{Params, Stored, compile};
use windlass_core::time::{Instant, TICK};
use windlass_firmware::exercise::Exercise;

const TICKS: u32 = 100_000;
/// A position loop moves and then stands.
const LOOP_TICKS: u32 = 2000;
const CALLS: u32 = 1000;
const NUMBER: u8 = 5;

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_pidf(law: &mut Pidf, gains: &Gains, target: i32, error: i32, unit: Unit) -> i32 {
    law.step(gains, target, error, unit)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_tick(
    engine: &mut Engine,
    settings: &Settings,
    sample: &Sample,
    command: &Command,
) -> Actuation {
    engine.tick(settings, sample, command).actuation
}

// A section of its own, or the linker would fold it into its twin above.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_loop_tick")]
#[inline(never)]
fn measured_loop_tick(
    engine: &mut Engine,
    settings: &Settings,
    sample: &Sample,
    command: &Command,
) -> Actuation {
    engine.tick(settings, sample, command).actuation
}

// The same.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_throttle_loop_tick")]
#[inline(never)]
fn measured_throttle_loop_tick(
    engine: &mut Engine,
    settings: &Settings,
    sample: &Sample,
    command: &Command,
) -> Actuation {
    engine.tick(settings, sample, command).actuation
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_throttle_law(law: &mut ThrottleLaw, gains: &ThrottleGains, input: &Input) -> i32 {
    law.step(gains, input)
}

// A section of its own, or the linker would fold it into its twin above.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_throttle_tick")]
#[inline(never)]
fn measured_throttle_tick(
    engine: &mut Engine,
    settings: &Settings,
    sample: &Sample,
    command: &Command,
) -> Actuation {
    engine.tick(settings, sample, command).actuation
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_talon_decode(talon: &mut TalonSrx, frame: &Frame) -> Decoded {
    talon.decode(NUMBER, frame)
}

// A section of its own, or the linker would fold it into its twin above.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_talon_foreign")]
#[inline(never)]
fn measured_talon_foreign(talon: &mut TalonSrx, frame: &Frame) -> Decoded {
    talon.decode(NUMBER, frame)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_control_decode(dialect: &mut Dmc60c, frame: &Frame) -> Decoded {
    dialect.decode(NUMBER, frame)
}

// A section of its own, or the linker would fold it into its twin above.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_foreign_decode")]
#[inline(never)]
fn measured_foreign_decode(dialect: &mut Dmc60c, frame: &Frame) -> Decoded {
    dialect.decode(NUMBER, frame)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_status_encode(view: &View<'_>) -> Frame {
    status_general(view).emit(NUMBER)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_node_control(node: &mut Node, now: Instant, frame: &Frame, snapshot: &Snapshot) {
    node.on_frame(now, frame, snapshot);
}

// A section of its own, or the linker would fold it into its twin above.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".text.measured_node_foreign")]
#[inline(never)]
fn measured_node_foreign(node: &mut Node, now: Instant, frame: &Frame, snapshot: &Snapshot) {
    node.on_frame(now, frame, snapshot);
}

#[unsafe(no_mangle)]
#[inline(never)]
fn measured_node_idle(node: &mut Node, now: Instant, snapshot: &Snapshot) -> bool {
    node.poll(now, snapshot);
    node.poll_tx(now, snapshot).is_some()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let snapshot = engine();
    position_loop(DialectKind::Dmc60c, measured_loop_tick);
    position_loop(DialectKind::TalonSrx, measured_throttle_loop_tick);
    law();
    throttle();
    dialect(&snapshot);
    node(&snapshot);
    debug::exit(debug::EXIT_SUCCESS);
    loop {}
}

/// Ticks over every mode and flag.
#[inline(never)]
fn engine() -> Snapshot {
    let mut engine = Engine::new();
    let mut exercise = Exercise::new(1);
    let mut actuation = Actuation::Off;
    for _ in 0..TICKS {
        exercise.advance(actuation);
        actuation = measured_tick(
            &mut engine,
            &exercise.settings,
            &exercise.sample,
            &exercise.command,
        );
    }
    *engine.tick(&exercise.settings, &exercise.sample, &exercise.command)
}

/// A motor that is held at a position: no fault, no pulse, a command every 20 ms, nothing else changes.
#[inline(never)]
fn position_loop(
    kind: DialectKind,
    tick: impl Fn(&mut Engine, &Settings, &Sample, &Command) -> Actuation,
) {
    let policy = kind.policy();
    let mut settings = compile::settings(&Params::default(), &Board::REFERENCE, &policy);
    for slot in &mut settings.slots {
        (slot.gains.p, slot.gains.i, slot.gains.d) = (3 << 16, 1 << 8, 5 << 16);
    }
    for slot in &mut settings.throttle_slots {
        (slot.p, slot.i, slot.d) = (3 << 20, 1 << 10, 5 << 22);
    }
    let mut engine = Engine::new();
    let mut command = Command {
        setpoint: Setpoint::Position(20_000),
        ..Command::default()
    };
    let mut sample = Sample {
        current: 2048,
        bus_voltage: 1365,
        temperature: 931,
        ..Sample::default()
    };
    let mut actuation = Actuation::Off;
    for at in 0..LOOP_TICKS {
        if at % 40 == 0 {
            command.revision += 1;
            command.sequence += 1;
            command.enable.sequence += 1;
        }
        // A motor of sorts: a duty cycle is a speed.
        let speed = i32::from(actuation.duty().units()) >> 11;
        sample.encoder = sample.encoder.wrapping_add(speed as u32);
        actuation = tick(&mut engine, &settings, &sample, &command);
    }
}

/// The law with every gain, inside and outside its dead band and its accumulator's limit.
#[inline(never)]
fn law() {
    let gains = Gains {
        p: 3 << 16,
        i: 1 << 8,
        d: 5 << 16,
        f: 1 << 15,
        accumulator_limit: 5000,
        allowable_error: 4,
    };
    let mut law = Pidf::new();
    for at in 0..CALLS as i32 {
        let error = (at * 7919) % 400 - 200;
        let unit = if at % 2 == 0 {
            Unit::Count
        } else {
            Unit::Fixed
        };
        black_box(measured_pidf(&mut law, &gains, at << 18, error, unit));
    }
}

/// The drive in throttle units: its law alone, whole ticks over every mode, sensor and flag, and its frames.
#[inline(never)]
fn throttle() {
    let gains = ThrottleGains {
        p: 3 << 20,
        i: 1 << 10,
        d: 5 << 22,
        f: 1 << 18,
        zone: 150,
        ramp: 40,
    };
    let mut law = ThrottleLaw::new();
    for at in 0..CALLS as i32 {
        let input = Input {
            target: at << 8,
            measured: (at << 8) - (at * 7919) % 400 + 200,
            applied: 0,
            reverse: at % 3 == 0,
            one_direction: at % 5 == 0,
        };
        black_box(measured_throttle_law(&mut law, &gains, &input));
    }
    let mut engine = Engine::new();
    let mut exercise = Exercise::new(1);
    let mut actuation = Actuation::Off;
    for _ in 0..TICKS {
        exercise.advance(actuation);
        let (settings, command) = exercise.in_throttle_units();
        actuation = measured_throttle_tick(&mut engine, &settings, &exercise.sample, &command);
    }
    let mut talon = TalonSrx::default();
    for at in 0..CALLS {
        let [low, middle, ..] = at.to_le_bytes();
        let base = [talon_id::CONTROL_1, talon_id::CONTROL_5][at as usize % 2];
        // Modes 0 to 7, every override, all sensors.
        let data = [0, 0, 0, middle, low, low, (at as u8) << 4 | low >> 4, 1];
        let frame = Frame::extended(base | u32::from(NUMBER), data);
        black_box(measured_talon_decode(&mut talon, &frame));
        black_box(measured_talon_foreign(&mut talon, &foreign(at)));
    }
}

fn control(at: u32) -> Frame {
    let [low, middle, ..] = at.to_le_bytes();
    // Modes 0 to 7 with all flags; the followed controller's number comes from the target.
    let flags = (at % 8) as u8 | (at as u8) << 4;
    Frame::extended(
        id::CONTROL_0 | u32::from(NUMBER),
        [flags, low, 0, 0, low, middle, 1, 0],
    )
}

/// An identifier of another manufacturer, another message, another device.
fn foreign(at: u32) -> Frame {
    let raw = [0x0205_0000, 0x0206_1C00, id::CONTROL_0 | 6][at as usize % 3];
    Frame::extended(raw, [0; 8])
}

#[inline(never)]
fn dialect(snapshot: &Snapshot) {
    let mut dialect = Dmc60c::default();
    let params = Params::default();
    let settings = compile::settings(&params, &Board::REFERENCE, &Dmc60c::POLICY);
    let view = View {
        number: NUMBER,
        params: &params,
        settings: &settings,
        snapshot,
        device: Device::default(),
    };
    for at in 0..CALLS {
        black_box(measured_control_decode(&mut dialect, &control(at)));
        black_box(measured_foreign_decode(&mut dialect, &foreign(at)));
        black_box(measured_status_encode(&view));
    }
}

#[inline(never)]
fn node(snapshot: &Snapshot) {
    let stored = Stored {
        number: NUMBER,
        ..Stored::default()
    };
    let mut now = Instant::ZERO;
    let mut node = Node::new(now, &NodeConfig::dmc60c(1), Some(&stored));
    node.on_frame(now, &foreign(0), snapshot);
    for at in 0..CALLS {
        now = now + TICK;
        measured_node_control(&mut node, now, &control(at), snapshot);
        measured_node_foreign(&mut node, now, &foreign(at), snapshot);
        black_box(measured_node_idle(&mut node, now, snapshot));
    }
}
