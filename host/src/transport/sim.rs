//! A simulated bus inside this process: waiting lets virtual time pass and costs no real time.

use std::time::Duration;

use windlass_core::frame::Frame;
use windlass_core::time;
use windlass_sim::{NodeSpec, ParticipantId, World, WorldConfig};

use super::{Bus, BusError, Health, Received};

/// Frames that wait for the bus before more are dropped.
const TRANSMIT_BUFFER: usize = 1024;

/// One participant in a [`World`] of its own.
#[derive(Debug)]
pub struct SimBus {
    world: World,
    participant: ParticipantId,
    tx_full: u64,
}

impl SimBus {
    /// Joins a world.
    #[must_use]
    pub fn new(mut world: World) -> Self {
        let participant = world.join("windlass");
        Self {
            world,
            participant,
            tx_full: 0,
        }
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
        if self.world.pending(self.participant) < TRANSMIT_BUFFER {
            self.world.send(self.participant, *frame);
        } else {
            self.tx_full += 1;
        }
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

    fn health(&mut self) -> Result<Health, BusError> {
        let mut health = Health {
            tx_full: Some(self.tx_full),
            ..Health::default()
        };
        if let Some(own) = self.world.participant(self.participant) {
            health.bus_off = Some(u64::from(own.bus_off_count));
            health.receive_errors = Some(own.rec);
            health.transmit_errors = Some(own.tec);
        }
        Ok(health)
    }
}
