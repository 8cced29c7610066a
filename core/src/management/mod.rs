//! The management channel.

pub mod vendor;
pub mod wire;
