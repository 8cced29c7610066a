//! Prints fingerprints of a long exercise of the engine for `cargo xtask trace`, which compares them
//! with those of the machine it runs on.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

use cortex_m_semihosting::{debug, hprintln};
use windlass_firmware::exercise::{self, SEED};

#[cortex_m_rt::entry]
fn main() -> ! {
    exercise::run(SEED, |ticks, fingerprint| {
        hprintln!("{} {:016x}", ticks, fingerprint)
    });
    debug::exit(debug::EXIT_SUCCESS);
    loop {}
}
