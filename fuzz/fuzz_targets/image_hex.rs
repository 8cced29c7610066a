//! Any bytes, and any edits of a sealed file, as Intel HEX: no panic, no damaged file is accepted, and what
//! is read is the same after writing and reading again.
#![no_main]

mod sample;

use libfuzzer_sys::fuzz_target;
use windlass::image::{Format, hex};

fuzz_target!(|input: &[u8]| {
    let sealed = || sample::image().write(Format::Hex).expect("pages can be written as HEX");
    let bytes = sample::bytes(input, sealed);
    if let Ok(memory) = hex::read(&bytes) {
        assert_eq!(hex::read(hex::write(&memory).as_bytes()), Ok(memory));
    }
    sample::check(Format::Hex, input, &bytes);
});
