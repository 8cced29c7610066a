//! A simulated bus inside this process: waiting lets virtual time pass and costs no real time.

use std::time::Duration;

use windlass_core::frame::Frame;
use windlass_core::time;
use windlass_sim::{NodeSpec, ParticipantId, World, WorldConfig};

use super::{Bus, BusError, Received};

/// One participant in a [`World`] of its own.
#[derive(Debug)]
pub struct SimBus {
    world: World,
    participant: ParticipantId,
}

impl SimBus {
    /// Joins a world.
    #[must_use]
    pub fn new(mut world: World) -> Self {
        let participant = world.join("windlass");
        Self { world, participant }
    }

    /// A new world with these nodes.
    #[must_use]
    pub fn with_nodes(nodes: &[NodeSpec]) -> Self {
        let mut world = World::new(WorldConfig::default());
        for node in nodes {
            world.add_node(*node);
        }
        Self::new(world)
    }

    /// The world around, to look at the truth and to poke it.
    pub fn world(&mut self) -> &mut World {
        &mut self.world
    }
}

impl Bus for SimBus {
    fn send(&mut self, frame: &Frame) -> Result<(), BusError> {
        self.world.send(self.participant, *frame);
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, BusError> {
        let micros = u64::try_from(timeout.as_micros()).unwrap_or(u64::MAX);
        let deadline = self.world.now() + time::Duration::from_micros(micros);
        let received = self
            .world
            .advance_until_received(self.participant, deadline);
        Ok(received.map(|received| Received {
            frame: received.frame,
            at: Duration::from_micros(received.at.as_micros()),
        }))
    }

    fn now(&self) -> Duration {
        Duration::from_micros(self.world.now().as_micros())
    }
}
