//! Windlass on microcontrollers.
//!
//! Three priorities, and values that cross between them:
//!
//! - a timer interrupt of top priority every 500 µs, which runs the engine and nothing else
//!   ([`control`]);
//! - interrupts below it, which only move bytes or frames into bounded queues;
//! - thread mode, which does everything that parses, waits or writes ([`thread`]).
//!
//! Commands, settings and snapshots cross in latest-wins cells ([`latest`]). The portable part of this
//! package compiles for a desktop and is tested there; what touches registers stands in `chip`, what a
//! board is in `board`.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod bootloader;
pub mod button;
pub mod clock;
pub mod control;
pub mod count;
pub mod exercise;
pub mod kept;
pub mod latest;
pub mod mailbox;
pub mod partition;
pub mod port;
pub mod record;
pub mod shunt;
pub mod thread;

#[cfg(target_os = "none")]
pub mod board;
#[cfg(all(target_os = "none", feature = "bootloader"))]
mod builtins;
#[cfg(target_os = "none")]
pub mod chip;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(all(target_os = "none", not(feature = "bootloader")))]
pub mod info;
#[cfg(all(target_os = "none", feature = "bootloader"))]
pub mod launch;
#[cfg(target_os = "none")]
pub mod log;
#[cfg(target_os = "none")]
pub mod memory;
#[cfg(target_os = "none")]
pub mod stack;
