//! Boards: one file each, chosen by feature. What STM32 boards share stands in `stm32`.

#[cfg(feature = "board-b-g431b-esc1")]
mod b_g431b_esc1;
#[cfg(feature = "board-b-g431b-esc1")]
pub use b_g431b_esc1::{bridge_off, run};
#[cfg(feature = "board-f405-devkit")]
mod f405_devkit;
#[cfg(feature = "board-f405-devkit")]
pub use f405_devkit::{bridge_off, run};
#[cfg(feature = "board-nucleo-g474re")]
mod nucleo_g474re;
#[cfg(feature = "board-nucleo-g474re")]
pub use nucleo_g474re::{bridge_off, run};
#[cfg(feature = "board-qemu")]
mod qemu;
#[cfg(feature = "board-qemu")]
pub use qemu::{bridge_off, micros, run};
#[cfg(any(
    feature = "board-b-g431b-esc1",
    feature = "board-f405-devkit",
    feature = "board-nucleo-g474re"
))]
mod stm32;
#[cfg(any(
    feature = "board-b-g431b-esc1",
    feature = "board-f405-devkit",
    feature = "board-nucleo-g474re"
))]
pub use stm32::micros;

#[cfg(not(any(
    feature = "board-b-g431b-esc1",
    feature = "board-f405-devkit",
    feature = "board-nucleo-g474re",
    feature = "board-qemu"
)))]
compile_error!("no board chosen: build with `cargo xtask firmware --board NAME`");
