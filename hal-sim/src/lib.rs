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
//!
//! Without its default feature `std` the crate is `no_std` and holds the plant alone ([`Rig`]), which the
//! firmware for the emulator carries in its image.
#![cfg_attr(not(feature = "std"), no_std)]
#![cfg_attr(
    not(feature = "std"),
    expect(dead_code, reason = "only the bench reads the plant's truth")
)]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
mod bits;
#[cfg(feature = "std")]
mod bus;
#[cfg(feature = "std")]
mod controller;
#[cfg(feature = "std")]
mod load;
#[cfg(feature = "std")]
mod node;
#[cfg(feature = "std")]
pub mod nor;
mod pins;
mod plant;
mod poke;
mod random;
#[cfg(feature = "std")]
mod replay;
mod rig;
#[cfg(feature = "std")]
mod spec;
#[cfg(feature = "std")]
mod ticker;
#[cfg(feature = "std")]
mod trace;
#[cfg(feature = "std")]
mod truth;
mod wires;
#[cfg(feature = "std")]
mod world;

#[cfg(feature = "std")]
pub use bits::occupied_bits;
#[cfg(feature = "std")]
pub use controller::ErrorState;
#[cfg(feature = "std")]
pub use node::{Chip, SimNode};
pub use plant::{Battery, Bridge, COUNTS_PER_REVOLUTION, DataSheet, FrontEnd, Motor, PlantConfig};
pub use poke::Poke;
#[cfg(feature = "std")]
pub use replay::{TickRecord, replay};
pub use rig::Rig;
#[cfg(feature = "std")]
pub use spec::{NodeSpec, NodeSpecError, WorldConfig};
#[cfg(feature = "std")]
pub use trace::{Source, TRACE_CAPACITY, TraceEntry};
#[cfg(feature = "std")]
pub use truth::Truth;
#[cfg(feature = "std")]
pub use world::{BusStatistics, ParticipantId, ParticipantStatistics, Received, World};
