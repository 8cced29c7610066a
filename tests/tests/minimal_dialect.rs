//! The example of docs/new-dialect.md drives a simulated motor, beside a DMC60C on the same bus.

use windlass_core::frame::Frame;
use windlass_core::params::table::ParameterId;
use windlass_core::time::Duration;
use windlass_sim::{World, WorldConfig};

fn world() -> (World, windlass_sim::ParticipantId) {
    let mut world = World::new(WorldConfig::default());
    world.add_node("minimal:7".parse().expect("a dialect of this build"));
    world.add_node("dmc60c:7".parse().expect("a dialect of this build"));
    let tool = world.join("test");
    world.advance(Duration::from_millis(50));
    (world, tool)
}

fn duty(world: &World, node: usize) -> i16 {
    world.node(node).expect("the node").truth().duty
}

#[test]
fn it_drives_times_out_and_leaves_the_other_dialect_alone() {
    let (mut world, tool) = world();
    let [low, high] = 5_000_i16.to_le_bytes();
    world.send(tool, Frame::standard(0x107, [low, high]));
    world.advance(Duration::from_millis(2));
    assert_eq!((duty(&world, 0), duty(&world, 1)), (5_000, 0));
    world.advance(Duration::from_millis(197));
    assert_eq!(duty(&world, 0), 5_000);
    world.advance(Duration::from_millis(3));
    assert_eq!(duty(&world, 0), 0);
}

#[test]
fn it_reads_parameters_and_reports_its_state() {
    let (mut world, tool) = world();
    for parameter in [ParameterId::CurrentMultiplier.code(), 99] {
        world.send(tool, Frame::standard(0x207, [parameter]));
    }
    world.advance(Duration::from_millis(200));
    let frames: Vec<_> = std::iter::from_fn(|| world.receive(tool))
        .map(|r| r.frame)
        .collect();
    assert!(frames.contains(&Frame::standard(0x287, [9, 0x16, 0x08, 0, 0])));
    assert!(frames.contains(&Frame::standard(0x287, [99])));
    assert!(frames.contains(&Frame::standard(0x187, [0; 6])));
}

#[test]
fn its_management_channel_is_the_one_of_every_dialect() {
    let (mut world, tool) = world();
    world.send(tool, Frame::extended(0x240, []));
    world.advance(Duration::from_millis(100));
    let answers = std::iter::from_fn(|| world.receive(tool))
        .filter(|received| received.frame.raw_id() == 0x0206_F007)
        .count();
    assert_eq!(
        answers, 4,
        "two from each of the two controllers numbered 7"
    );
}
