//! A bench for tests of the Talon dialect: controllers on a virtual bus, driven by the host's client through
//! frames only; the plant's truth judges.

use std::time::Duration;

use windlass::client::talon::{CanTalon, Profile, Robot};
use windlass::transport::SimBus;
use windlass_core::dialect::talon_srx::wire::{Control1, General, Status1, Status2, id};
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_sim::{ParticipantId, PlantConfig, Poke, TraceEntry, Truth, World, WorldConfig};

/// The motor controller under test.
pub type Talon = CanTalon<SimBus>;

/// Robot controller and Talons on one bus.
pub struct TalonBench {
    /// The robot controller.
    pub robot: Robot<SimBus>,
    /// Another CAN tool.
    pub other: ParticipantId,
}

/// Gains for the default plant in velocity mode: feed-forward to about the speed of each throttle, the rest
/// by P and I.
pub const VELOCITY: Profile = Profile {
    p: 0.01,
    i: 0.0001,
    d: 0.0,
    f: 0.0268,
    i_zone: 0,
    close_loop_ramp_rate: 0.0,
};

/// Gains for the default plant in position mode.
pub const POSITION: Profile = Profile {
    p: 0.1,
    i: 0.001,
    d: 3.0,
    f: 0.0,
    i_zone: 200,
    close_loop_ramp_rate: 0.0,
};

impl TalonBench {
    /// These nodes, with 100 ms to see each other.
    #[must_use]
    pub fn new(nodes: &[&str]) -> Self {
        Self::with(WorldConfig::default(), nodes)
    }

    /// These nodes in a world of one's own.
    #[must_use]
    pub fn with(config: WorldConfig, nodes: &[&str]) -> Self {
        let mut world = World::new(config);
        for node in nodes {
            world.add_node(node.parse().expect("a good node"));
        }
        Self::around(world)
    }

    /// `talon:3` on a plant of one's own.
    #[must_use]
    pub fn on_plant(plant: &PlantConfig) -> Self {
        let mut world = World::new(WorldConfig::default());
        world.add_node_with_plant("talon:3".parse().expect("a good node"), plant);
        Self::around(world)
    }

    fn around(mut world: World) -> Self {
        let other = world.join("other");
        let bench = Self {
            robot: Robot::new(SimBus::new(world)),
            other,
        };
        bench.run(300);
        bench
    }

    /// `talon:3` alone on the bus, enabled, in mode "No Drive".
    #[must_use]
    pub fn enabled() -> (Self, Talon) {
        let bench = Self::new(&["talon:3"]);
        let talon = bench.talon(3);
        bench.robot.enable().expect("the bus works");
        bench.run(20);
        (bench, talon)
    }

    /// The client of a Talon.
    #[must_use]
    pub fn talon(&self, number: u8) -> Talon {
        self.robot.talon(number).expect("a good number")
    }

    /// Lets milliseconds pass.
    pub fn run(&self, millis: u64) {
        self.run_us(millis * 1000);
    }

    /// Lets microseconds pass.
    pub fn run_us(&self, micros: u64) {
        let span = Duration::from_micros(micros);
        self.robot.run(span).expect("the bus works");
    }

    /// Works on the world.
    pub fn world<T>(&self, work: impl FnOnce(&mut World) -> T) -> T {
        self.robot.lend(|client| work(client.bus().world()))
    }

    /// Truth of a node.
    #[must_use]
    pub fn truth(&self, index: usize) -> Truth {
        self.world(|world| world.node(index).expect("the node").truth())
    }

    /// Throttle at the terminals of a node, −1023 to 1023.
    #[must_use]
    pub fn throttle(&self, index: usize) -> i32 {
        (f64::from(self.truth(index).duty) / 32767.0 * 1023.0).round() as i32
    }

    /// Interferes with a node.
    pub fn poke(&self, index: usize, poke: Poke) {
        self.world(|world| world.node_mut(index).expect("the node").poke(poke));
    }

    /// The other tool sends a frame, and 1 ms passes.
    pub fn inject(&self, frame: Frame) {
        let other = self.other;
        self.world(|world| world.send(other, frame));
        self.run(1);
    }

    /// Another host's control frame, and 1 ms.
    pub fn control(&self, number: u8, general: General) {
        let control = Control1 {
            token: 0,
            general: Some(general),
        };
        self.inject(control.emit(number));
    }

    /// Number of the next frame on the bus.
    #[must_use]
    pub fn next_frame(&self) -> u64 {
        self.world(|world| world.bus().frames)
    }

    /// Frames from number `from` on with this base identifier and device number.
    #[must_use]
    pub fn frames(&self, from: u64, base: u32, number: u8) -> Vec<TraceEntry> {
        let wanted = frc_id::with_number(base, number);
        let all = self.world(|world| world.trace_since(from, usize::MAX));
        all.into_iter()
            .filter(|entry| entry.frame.extended_id() == Some(wanted))
            .collect()
    }

    /// General status frames from number `from` on.
    #[must_use]
    pub fn general(&self, from: u64, number: u8) -> Vec<Status1> {
        let frames = self.frames(from, id::STATUS_1, number);
        let parse = |entry: &TraceEntry| Status1::parse(&entry.frame).expect("eight bytes");
        frames.iter().map(parse).collect()
    }

    /// Feedback status frames from number `from` on.
    #[must_use]
    pub fn feedback(&self, from: u64, number: u8) -> Vec<Status2> {
        let frames = self.frames(from, id::STATUS_2, number);
        let parse = |entry: &TraceEntry| Status2::parse(&entry.frame).expect("eight bytes");
        frames.iter().map(parse).collect()
    }
}
