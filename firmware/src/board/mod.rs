//! Boards: one file each, chosen by feature.

#[cfg(feature = "board-qemu")]
mod qemu;
#[cfg(feature = "board-qemu")]
pub use qemu::{bridge_off, run};

#[cfg(not(feature = "board-qemu"))]
compile_error!("no board chosen: build with `cargo xtask firmware --board NAME`");
