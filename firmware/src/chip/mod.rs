//! Chips: what touches registers. One folder per family with what it has in common in `stm32`; a board uses
//! exactly one of them.

#[cfg(feature = "stm32")]
pub mod stm32;
#[cfg(feature = "stm32f405")]
pub mod stm32f405;
#[cfg(feature = "board-qemu")]
pub mod stm32f405_emulated;
#[cfg(feature = "stm32g4")]
pub mod stm32g4;

// The family of the chosen board, by one name.
#[cfg(feature = "stm32f405")]
pub use stm32f405 as family;
#[cfg(feature = "board-qemu")]
pub use stm32f405_emulated as family;
#[cfg(feature = "stm32g4")]
pub use stm32g4 as family;
