//! The answers of the JSON API.

use serde_json::{Map, Value, json};
use windlass_core::engine::command::{Neutral, Setpoint};
use windlass_core::engine::snapshot::{DriveState, Fault, Faults, Mode};
use windlass_core::management::wire::ImageType;
use windlass_core::node::Counters;
use windlass_core::params::SettingsState;
use windlass_core::slcan::State;
use windlass_sim::{SimNode, Source, TraceEntry};

use super::link::Link;
use super::meaning;
use super::server::Bench;
use crate::client::{fault_name, image_name};

/// `GET /api/sim`.
pub(super) fn bench(bench: &Bench) -> Value {
    let (world, bus, counters) = (bench.world(), bench.world().bus(), bench.counters());
    let nodes: Vec<Value> = (0..world.nodes()).map(|index| node(bench, index)).collect();
    json!({
        "t_us": world.now().as_micros(),
        "paused": bench.pacer().is_none(),
        "speed": bench.pacer().map_or(0.0, |pacer| pacer.speed()),
        "slips": bench.pacer().map_or(0, |pacer| pacer.slips()),
        "bus_load_percent": rounded(bus.load_percent),
        "frames": bus.frames,
        "error_frames": bus.error_frames,
        "trace_end": bus.frames,
        "clients": bench.links().iter().map(|link| client(bench, link)).collect::<Vec<_>>(),
        "clients_accepted": counters.accepted,
        "clients_disconnected": counters.disconnected,
        "nodes": nodes,
    })
}

fn client(bench: &Bench, link: &Link) -> Value {
    let (channel, counters) = (link.channel(), link.channel().counters());
    let own = bench.world().participant(link.participant());
    let state = match channel.state() {
        State::OpenAtStart | State::Open => "open",
        State::ListenOnly => "listen-only",
        State::Closed => "closed",
    };
    json!({
        "name": link.name(),
        "state": state,
        "bit_rate": channel.bit_rate(),
        "frames_in": counters.frames,
        "frames_out": link.frames_out(),
        "malformed": counters.malformed,
        "refused": counters.refused,
        "backlog_bytes": link.backlog(),
        "tec": own.as_ref().map(|own| own.tec),
        "rec": own.as_ref().map(|own| own.rec),
        "error_state": own.as_ref().map(|own| own.state.name()),
        "bus_off_count": own.as_ref().map(|own| own.bus_off_count),
    })
}

/// `GET /api/sim/nodes/{id}`; null if there is no such node.
pub(super) fn node(bench: &Bench, index: usize) -> Value {
    let Some(sim) = bench.world().node(index) else {
        return Value::Null;
    };
    let mut fields = truth(index, sim);
    fields.extend(running(sim));
    fields.insert("pokes".to_owned(), bench.held(index).clone().into());
    Value::Object(fields)
}

/// Plant and pins, whatever the node believes.
fn truth(index: usize, sim: &SimNode) -> Map<String, Value> {
    let truth = sim.truth();
    let ring: Vec<&str> = truth.leds.ring.iter().map(|colour| colour.name()).collect();
    object(json!({
        "index": index,
        "dialect": truth.dialect.name(),
        "number": truth.number,
        "position_counts": truth.position_counts,
        "velocity_counts_per_100ms": rounded(truth.velocity_counts_per_100ms),
        "current_a": rounded(truth.current_a),
        "bus_v": rounded(truth.bus_v),
        "temp_c": rounded(truth.temp_c),
        "analog_v": rounded(truth.analog_v),
        "duty": truth.duty,
        "neutral": match truth.neutral {
            Neutral::Brake => "brake",
            Neutral::Coast => "coast",
        },
        "fwd_limit_closed": truth.fwd_limit_closed,
        "rev_limit_closed": truth.rev_limit_closed,
        "index_pin": truth.index_pin,
        "leds": { "ring": ring, "brake": truth.leds.brake.name() },
        "mode": match truth.mode {
            ImageType::Application => "application",
            image => image_name(image),
        },
        "powered": truth.powered,
        "bus_connected": truth.bus_connected,
        "flash_writes": truth.flash_writes,
        "flash_erases": truth.flash_erases,
        "settings": truth.settings.map(SettingsState::name),
        "tec": truth.tec,
        "rec": truth.rec,
        "error_state": truth.error_state.name(),
        "bus_off_count": truth.bus_off_count,
    }))
}

/// What the node believes and does.
fn running(sim: &SimNode) -> Map<String, Value> {
    let snapshot = sim.snapshot();
    let node = sim.node();
    let session = node.and_then(|node| node.session());
    let link = match (session, snapshot.pulse_valid) {
        (Some(_), _) => "can",
        (None, true) => "pwm",
        (None, false) => "none",
    };
    let setpoint = node.map_or(Setpoint::Off, |node| node.command().setpoint);
    let sticky = node.map_or(Faults::NONE, |node| node.faults().sticky());
    let counters = node.map_or_else(Counters::default, |node| *node.counters());
    object(json!({
        "session": session,
        "link": link,
        "state": match snapshot.state {
            DriveState::SelfCheck => "self-check",
            DriveState::Halted => "halted",
            DriveState::Running => "running",
        },
        "drive_mode": mode_name(snapshot.mode),
        "target": target(setpoint),
        "current_limited": snapshot.current_limited,
        "faults": { "active": names(snapshot.faults), "sticky": names(sticky) },
        "counters": {
            "received": counters.received,
            "ignored": counters.ignored,
            "bad_length": counters.bad_length,
            "remote": counters.remote,
            "wrong_session": counters.wrong_session,
            "unexpected": counters.unexpected,
            "answers_lost": counters.answers_lost,
            "bus_losses": counters.bus_losses,
            "dropped": counters.dropped,
            "given_up": counters.given_up,
            "bus_errors": counters.bus_errors,
        },
    }))
}

fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Duty => "duty",
        Mode::Velocity => "velocity",
        Mode::Position => "position",
        Mode::Current => "current",
        Mode::Voltage => "voltage",
        Mode::Follow => "follow",
        Mode::Pulse => "pulse",
        Mode::Off => "off",
    }
}

/// The target in the unit of its mode: duty −32768 to 32767, counts per 100 ms, counts, A, V, or the
/// number of the controller that is followed; 0 without one.
fn target(setpoint: Setpoint) -> Value {
    match setpoint {
        Setpoint::Off | Setpoint::Neutral | Setpoint::Pulse => json!(0),
        Setpoint::Duty(duty) => json!(duty.units()),
        Setpoint::Velocity(counts) | Setpoint::Position(counts) => json!(counts),
        Setpoint::Current(value) | Setpoint::Voltage(value) => json!(rounded(value.to_num())),
        Setpoint::Follow(number) => json!(number),
    }
}

fn names(faults: Faults) -> Vec<&'static str> {
    Fault::ALL
        .into_iter()
        .filter(|fault| faults.contains(*fault))
        .map(fault_name)
        .collect()
}

/// One frame of `GET /api/sim/trace`, with its meaning in words if `decode` asks for it.
pub(super) fn trace_entry(entry: &TraceEntry, decode: bool) -> Value {
    let data = entry.frame.data().iter();
    let mut fields = object(json!({
        "seq": entry.seq,
        "t_us": entry.at.as_micros(),
        "id": entry.frame.raw_id(),
        "ext": entry.frame.is_extended(),
        "rtr": entry.frame.is_remote(),
        "dlc": entry.frame.dlc(),
        "data": data.map(|byte| format!("{byte:02x}")).collect::<String>(),
        "from": match &entry.from {
            Source::Node(index) => json!(index),
            Source::Participant(name) => json!(name),
        },
    }));
    if decode {
        fields.insert("text".to_owned(), json!(meaning::of(&entry.frame)));
    }
    Value::Object(fields)
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

/// Six digits behind the point are more than any sensor has.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
