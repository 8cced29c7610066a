//! The DMC60C dialect.

pub mod wire;
