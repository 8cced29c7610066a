//! Any bytes, and any edits of a sealed file, as ELF or bare binary: no panic, and no damaged file is
//! accepted.
#![no_main]

mod sample;

use libfuzzer_sys::fuzz_target;
use windlass::image::Format;

/// A linker's file of one segment: file header and program header (System V ABI), then the contents.
fn linked(contents: &[u8]) -> Vec<u8> {
    const SLOT: u32 = 0x0802_0000;
    let length = contents.len() as u32;
    let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0\x02\0\x28\0".to_vec();
    for word in [1, SLOT | 1, 52, 0, 0x0500_0400] {
        file.extend(u32::to_le_bytes(word));
    }
    for half in [52, 32, 1, 40, 0, 0] {
        file.extend(u16::to_le_bytes(half));
    }
    for word in [1, 84, SLOT, SLOT, length, length, 5, 4] {
        file.extend(u32::to_le_bytes(word));
    }
    file.extend(contents);
    file
}

fuzz_target!(|input: &[u8]| {
    let sealed = || {
        let file = linked(&sample::application());
        sample::image().seal_elf(&file, 0x0802_0000).expect("an ELF file takes a header")
    };
    let bytes = sample::bytes(input, sealed);
    sample::check(Format::Elf, input, &bytes);
    if !input.starts_with(b"E") {
        sample::check(Format::Bin, input, &bytes);
    }
});
