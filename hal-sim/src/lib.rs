//! The virtual bench.
#![forbid(unsafe_code)]

mod bits;
mod bus;
mod controller;
mod load;
mod plant;
mod random;

pub use controller::ErrorState;
pub use plant::{Battery, Bridge, COUNTS_PER_REVOLUTION, DataSheet, FrontEnd, Motor, PlantConfig};
