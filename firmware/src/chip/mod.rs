//! Chips: what touches registers. One file per chip; a board uses exactly one of them.

#[cfg(feature = "board-f405-devkit")]
pub mod stm32f405;
#[cfg(feature = "board-qemu")]
pub mod stm32f405_emulated;
