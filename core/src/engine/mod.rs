//! The control engine.

pub mod command;
pub mod snapshot;
