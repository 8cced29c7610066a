//! Chips: what touches registers. One folder per family with what it has in common in `stm32`; a board uses
//! exactly one of them.

#[cfg(any(
    feature = "board-f405-devkit",
    feature = "board-b-g431b-esc1",
    feature = "board-nucleo-g474re"
))]
pub mod stm32;
#[cfg(feature = "board-f405-devkit")]
pub mod stm32f405;
#[cfg(feature = "board-qemu")]
pub mod stm32f405_emulated;
#[cfg(any(feature = "board-b-g431b-esc1", feature = "board-nucleo-g474re"))]
pub mod stm32g4;

// The family of the chosen board, by one name.
#[cfg(feature = "board-f405-devkit")]
pub use stm32f405 as family;
#[cfg(feature = "board-qemu")]
pub use stm32f405_emulated as family;
#[cfg(any(feature = "board-b-g431b-esc1", feature = "board-nucleo-g474re"))]
pub use stm32g4 as family;
