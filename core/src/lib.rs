//! The portable core of Windlass: control engine, dialects, parameters and management channel of a CAN
//! motor controller.
//!
//! Data flows one way: frames become intents, intents become one complete
//! [`Command`](engine::command::Command), and every 500 µs the [`engine`] turns a
//! [`Sample`](engine::snapshot::Sample) and that command into an
//! [`Actuation`](engine::snapshot::Actuation) and a [`Snapshot`](engine::snapshot::Snapshot), from
//! which status frames are made. No module reads a clock, allocates, does input or output, or panics.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing
    )
)]

pub mod boot;
pub mod bridge;
pub mod crc;
pub mod dialect;
pub mod engine;
pub mod field;
pub mod frame;
pub mod frc_id;
pub mod led;
pub mod management;
pub mod node;
pub mod params;
pub mod reset;
pub mod slcan;
pub mod time;
pub mod units;
