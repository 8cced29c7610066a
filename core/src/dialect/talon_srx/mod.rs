//! The Talon SRX dialect (firmware 1.1).
//!
//! Source: Talon SRX Software Reference Manual, rev 1.0; frames and decisions by `docs/talon-srx.md`.

pub mod wire;
