//! Boards: one file each, chosen by feature.

#[cfg(feature = "board-f405-devkit")]
mod f405_devkit;
#[cfg(feature = "board-f405-devkit")]
pub use f405_devkit::{bridge_off, run};
#[cfg(feature = "board-qemu")]
mod qemu;
#[cfg(feature = "board-qemu")]
pub use qemu::{bridge_off, run};

#[cfg(not(any(feature = "board-f405-devkit", feature = "board-qemu")))]
compile_error!("no board chosen: build with `cargo xtask firmware --board NAME`");
