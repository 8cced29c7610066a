//! The virtual bench of Windlass: [`windlass_core`] on virtual boards, on a virtual CAN bus.
//!
//! A [`World`] holds one bus with any number of simulated controllers ([`SimNode`]) and CAN tools
//! ([`World::join`]). Time is virtual: it passes only in [`World::advance`] and
//! [`World::advance_until_received`], as fast as the machine can, and nothing sleeps. The bus arbitrates
//! by the real arbitration field, counts real bit times with stuff bits, and keeps the error counters of
//! every participant; each controller drives a motor model with battery, bridge, encoder and sensors
//! ([`PlantConfig`]). [`SimNode::truth`] tells what really happens, [`SimNode::poke`] interferes.
//!
//! ```
//! use windlass_core::frame::Frame;
//! use windlass_core::time::Duration;
//! use windlass_sim::{World, WorldConfig};
//!
//! let mut world = World::new(WorldConfig::default());
//! world.add_node("dmc60c:5".parse().unwrap());
//! let tool = world.join("tool");
//! // Who is there? (DMC60C enumeration)
//! world.send(tool, Frame::extended(0x240, []));
//! let deadline = world.now() + Duration::from_millis(100);
//! let answer = world.advance_until_received(tool, deadline).unwrap();
//! assert_eq!(answer.frame.extended_id(), Some(0x0206_F005));
//! ```
#![forbid(unsafe_code)]

mod bits;
mod bus;
mod controller;
mod load;
mod node;
mod pins;
mod plant;
mod random;
mod replay;
mod spec;
mod ticker;
mod trace;
mod truth;
mod world;

pub use bits::occupied_bits;
pub use controller::ErrorState;
pub use node::SimNode;
pub use plant::{Battery, Bridge, COUNTS_PER_REVOLUTION, DataSheet, FrontEnd, Motor, PlantConfig};
pub use replay::{TickRecord, replay};
pub use spec::{NodeSpec, NodeSpecError, WorldConfig};
pub use trace::{Source, TRACE_CAPACITY, TraceEntry};
pub use truth::{Poke, Truth};
pub use world::{BusStatistics, ParticipantId, ParticipantStatistics, Received, World};
