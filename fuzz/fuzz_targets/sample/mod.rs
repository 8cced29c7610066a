//! A sealed image to edit: random bytes alone would hardly get past the first CRC.

use std::sync::OnceLock;

use windlass::image::{Format, Image, parse};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock};
use windlass_core::node::PRODUCT_DMC60C;

/// An application of two pages.
pub fn application() -> Vec<u8> {
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware: Hardware::F405.id,
        version: 0x0119,
        rollback: 3,
    };
    let mut bytes: Vec<u8> = (0..5000_u32).map(|at| (at * 7 >> 3) as u8).collect();
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    bytes
}

/// The same, sealed.
pub fn image() -> &'static Image {
    static IMAGE: OnceLock<Image> = OnceLock::new();
    IMAGE.get_or_init(|| {
        let contents = parse(Format::Bin, &application()).expect("a whole application");
        Image::packed(contents).expect("it can be packed")
    })
}

/// Bytes to read: the fuzzer's own, or `file` with the edits that they stand for: an offset of three bytes,
/// what to do, and a value.
pub fn bytes(input: &[u8], file: impl FnOnce() -> Vec<u8>) -> Vec<u8> {
    let Some(edits) = input.strip_prefix(b"E") else {
        return input.to_vec();
    };
    let mut bytes = file();
    for edit in edits.chunks_exact(5) {
        if bytes.is_empty() {
            break;
        }
        let at = u32::from_le_bytes([edit[0], edit[1], edit[2], 0]) as usize % bytes.len();
        match edit[3] % 4 {
            0 => bytes[at] = edit[4],
            1 => bytes[at] ^= 1 << (edit[4] % 8),
            2 => bytes.insert(at, edit[4]),
            _ => drop(bytes.drain(at..(at + usize::from(edit[4])).min(bytes.len()))),
        }
    }
    bytes
}

/// What is accepted as sealed is the sample itself or, without edits, survives every format.
pub fn check(format: Format, input: &[u8], bytes: &[u8]) {
    let Ok(contents) = parse(format, bytes) else { return };
    if input.starts_with(b"E") && contents.is_sealed() {
        assert_eq!(Image::sealed(contents).as_ref().expect("a seal that was checked"), image());
        return;
    }
    let Ok(image) = Image::packed(contents) else { return };
    for other in [Format::Hex, Format::Bin, Format::Container, Format::Crf] {
        let file = image.write(other).expect("pages can be written in this format");
        let again = parse(other, &file).and_then(Image::sealed).expect("what was written is whole");
        assert_eq!(again, image);
    }
}
