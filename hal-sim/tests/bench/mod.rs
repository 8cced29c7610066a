//! A user's view of a world.

use windlass_core::dialect::dmc60c::wire::{Control0, ModeSelect};
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::management::vendor::Command;
use windlass_core::management::wire::{
    EnumerateResponse0, ParameterResponse, ParameterSet, VendorCommand, VendorStatus, id,
};
use windlass_core::params::table::ParameterId;
use windlass_core::time::Duration;
use windlass_sim::{ParticipantId, Poke, Received, Truth, World, WorldConfig};

/// A world with one tool, and helpers of a user's length.
pub(crate) struct Bench {
    pub(crate) world: World,
    pub(crate) tool: ParticipantId,
}

impl Bench {
    pub(crate) fn new(nodes: &[&str]) -> Self {
        Self::with(WorldConfig::default(), nodes)
    }

    pub(crate) fn with(config: WorldConfig, nodes: &[&str]) -> Self {
        let mut world = World::new(config);
        for node in nodes {
            world.add_node(node.parse().unwrap());
        }
        let tool = world.join("test");
        Self { world, tool }
    }

    pub(crate) fn run(&mut self, millis: u32) {
        self.world.advance(Duration::from_millis(millis));
    }

    pub(crate) fn truth(&self, index: usize) -> Truth {
        self.world.node(index).unwrap().truth()
    }

    pub(crate) fn poke(&mut self, index: usize, poke: Poke) {
        self.world.node_mut(index).unwrap().poke(poke);
    }

    pub(crate) fn drain(&mut self) -> Vec<Received> {
        std::iter::from_fn(|| self.world.receive(self.tool)).collect()
    }

    /// Frames of one kind received since the last look.
    pub(crate) fn of_kind(&mut self, base: u32) -> Vec<Received> {
        let mut frames = self.drain();
        frames.retain(|received| frc_id::base(received.frame.raw_id()) == base);
        frames
    }

    /// Number and session of every node that answers.
    pub(crate) fn enumerate(&mut self) -> Vec<(u8, u16)> {
        self.drain();
        self.world
            .send(self.tool, Frame::extended(id::ENUMERATE, []));
        self.run(150);
        self.of_kind(id::ENUMERATE_RESPONSE)
            .iter()
            .filter_map(|received| {
                let answer = EnumerateResponse0::parse(&received.frame)?;
                Some((frc_id::number(received.frame.raw_id()), answer.session))
            })
            .collect()
    }

    pub(crate) fn drive(&mut self, number: u8, mode: ModeSelect, target: i32) {
        let control = Control0 {
            mode,
            target,
            ..Control0::default()
        };
        self.world.send(self.tool, control.emit(number));
    }

    /// Drives for a while with a control frame every 20 ms.
    pub(crate) fn drive_for(&mut self, number: u8, mode: ModeSelect, target: i32, millis: u32) {
        for _ in 0..millis / 20 {
            self.drive(number, mode, target);
            self.run(20);
        }
    }

    pub(crate) fn command(
        &mut self,
        (number, session): (u8, u16),
        command: Command,
        one: u16,
    ) -> u16 {
        self.drain();
        let request = VendorCommand {
            session,
            command: command.code(),
            param1: one,
            param2: 0,
        };
        self.world.send(self.tool, request.emit(number));
        self.run(30);
        let status = self.of_kind(id::VENDOR_STATUS);
        assert_eq!(status.len(), 1, "one answer to {command:?}");
        VendorStatus::parse(&status[0].frame).unwrap().code
    }

    pub(crate) fn set(&mut self, (number, session): (u8, u16), parameter: ParameterId, value: u32) {
        self.drain();
        let request = ParameterSet {
            session,
            parameter: parameter as u8,
            value,
        };
        self.world.send(self.tool, request.emit(number));
        self.run(20);
        let answers = self.of_kind(id::PARAMETER_RESPONSE);
        let answer = ParameterResponse::parse(&answers[0].frame).unwrap();
        assert_eq!((answer.code, answer.value), (0, value));
    }
}
