//! Any bytes, and any edits of a sealed file, as `.wlimg` and `.crf`: no panic, and no damaged file is
//! accepted.
#![no_main]

mod sample;

use libfuzzer_sys::fuzz_target;
use windlass::image::Format;

fuzz_target!(|input: &[u8]| {
    for format in [Format::Container, Format::Crf] {
        let sealed = || sample::image().write(format).expect("pages can be written");
        let bytes = sample::bytes(input, sealed);
        sample::check(format, input, &bytes);
    }
});
