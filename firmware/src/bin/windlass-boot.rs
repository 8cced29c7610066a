//! The bootloader image: `cargo xtask firmware --board NAME`.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    windlass_firmware::board::boot()
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image runs on a microcontroller: build it with `cargo xtask firmware`");
    std::process::exit(1);
}
