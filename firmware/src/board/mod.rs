//! Boards: one file each, chosen by feature. What STM32 boards share stands in `stm32`, and their bootloader in
//! `stm32_boot`.

/// Defines the modules of all boards. The bootloader uses of a board only what it needs to answer on the bus.
macro_rules! boards {
    ($($feature:literal $module:ident,)*) => {
        $(
            #[cfg(feature = $feature)]
            #[cfg_attr(feature = "bootloader", allow(dead_code, unused_imports))]
            mod $module;
            #[cfg(all(feature = $feature, feature = "bootloader"))]
            pub use $module::boot;
            #[cfg(all(feature = $feature, not(feature = "bootloader")))]
            pub use $module::{bridge_off, run};
        )*
        #[cfg(not(any($(feature = $feature),*)))]
        compile_error!("no board chosen: build with `cargo xtask firmware --board NAME`");
    };
}

boards! {
    "board-b-g431b-esc1" b_g431b_esc1,
    "board-f405-devkit" f405_devkit,
    "board-nucleo-g474re" nucleo_g474re,
    "board-qemu" qemu,
}

// What the boards with the kit share.
#[cfg(feature = "kit")]
#[cfg_attr(feature = "bootloader", allow(dead_code, unused_imports))]
mod kit;
#[cfg(feature = "stm32")]
#[cfg_attr(feature = "bootloader", allow(dead_code, unused_imports))]
mod stm32;
#[cfg(all(feature = "bootloader", feature = "stm32"))]
mod stm32_boot;

#[cfg(feature = "board-qemu")]
pub use qemu::micros;
#[cfg(feature = "stm32")]
pub use stm32::micros;

/// The bridge is off: the bootloader leaves all its pins as inputs, as a reset does.
#[cfg(feature = "bootloader")]
pub const fn bridge_off() {}
