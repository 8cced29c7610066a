//! How fast the bench is: simulated seconds per second on one core, with 1 and 16 nodes that drive their
//! motors in velocity mode, a control frame to each every 10 ms, all status frames at their default
//! periods.
//!
//! `cargo run --release -p windlass-sim --example speed [SECONDS]` (simulated seconds, default 60).

use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_core::management::wire::{EnumerateResponse0, ParameterSet, id};
use windlass_core::params::table::ParameterId;
use windlass_core::time::Duration;
use windlass_sim::{ParticipantId, World, WorldConfig};

const CONTROL_PERIOD: Duration = Duration::from_millis(10);

fn main() {
    let seconds = match std::env::args().nth(1).map(|text| text.parse()) {
        None => 60,
        Some(Ok(seconds)) => seconds,
        Some(Err(error)) => {
            eprintln!(
                "the number of simulated seconds is not a whole number ({error}); give one, for example 60"
            );
            std::process::exit(2);
        }
    };
    for nodes in [1, 16] {
        measure(nodes, seconds);
    }
}

fn measure(nodes: u8, seconds: u32) {
    let mut world = World::new(WorldConfig::default());
    for number in 1..=nodes {
        let spec = format!("dmc60c:{number}").parse().expect("a device number");
        world.add_node(spec);
    }
    let tool = world.join("speed");
    set_gains(&mut world, tool);

    let began = std::time::Instant::now();
    for _ in 0..seconds * 100 {
        for number in 1..=nodes {
            let control = Control0 {
                mode: ModeSelect::Velocity,
                target: 10_000,
                ..Control0::default()
            };
            world.send(tool, control.emit(number));
        }
        world.advance(CONTROL_PERIOD);
        while world.receive(tool).is_some() {}
    }
    let taken = began.elapsed().as_secs_f64();

    let velocity = world
        .node(0)
        .map_or(0.0, |node| node.truth().velocity_counts_per_100ms);
    let bus = world.bus();
    println!(
        "{nodes:2} nodes: {:6.0} simulated seconds per second, {:3.0} ns per node and tick \
         (bus load {:.0} %, {} frames per simulated second, {} error frames, velocity {velocity:.0}, \
         actuation hash {:016x})",
        f64::from(seconds) / taken,
        taken * 1e9 / (f64::from(seconds) * 2000.0 * f64::from(nodes)),
        bus.load_percent,
        bus.frames / u64::from(seconds),
        bus.error_frames,
        world.actuation_hash(0),
    );
}

/// Proportional and feed-forward gains for every node that answers an enumeration.
fn set_gains(world: &mut World, tool: ParticipantId) {
    world.send(
        tool,
        windlass_core::frame::Frame::extended(id::ENUMERATE, []),
    );
    world.advance(Duration::from_millis(150));
    while let Some(received) = world.receive(tool) {
        let Some(answer) = EnumerateResponse0::parse(&received.frame) else {
            continue;
        };
        let raw = received.frame.raw_id();
        if windlass_core::frc_id::base(raw) != id::ENUMERATE_RESPONSE {
            continue;
        }
        for (parameter, value) in [
            (ParameterId::Slot0P, 1 << 16),
            (ParameterId::Slot0F, 7 << 13),
        ] {
            let set = ParameterSet {
                session: answer.session,
                parameter: parameter as u8,
                value,
            };
            world.send(tool, set.emit(windlass_core::frc_id::number(raw)));
        }
    }
    world.advance(Duration::from_millis(50));
}
