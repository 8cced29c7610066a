//! The image format: fixed offsets, what each check refuses, and that no flipped bit passes.

extern crate std;

use std::boxed::Box;
use std::collections::BTreeMap;
use std::vec::Vec;

use super::*;
use crate::node::PRODUCT_DMC60C;
use proptest::prelude::*;

const IDENTITY: Identity = Identity {
    product: PRODUCT_DMC60C,
    hardware: Hardware::F405.id,
    version: 0x0118,
    rollback: 7,
};

/// An image in memory; missing pages read as erased flash.
#[derive(Clone)]
struct Memory(BTreeMap<u8, Box<Page>>);

impl ReadPages for Memory {
    type Error = ();
    fn read(&mut self, page: u8, offset: usize, bytes: &mut [u8]) -> Result<(), ()> {
        match self.0.get(&page) {
            Some(page) => bytes.copy_from_slice(&page[offset..offset + bytes.len()]),
            None => bytes.fill(0xFF),
        }
        Ok(())
    }
}

fn plain(identity: Identity, pages: &[u8]) -> Memory {
    let mut memory = BTreeMap::new();
    for page in pages {
        let fill = |at: usize| (at as u8).wrapping_mul(7) ^ page;
        memory.insert(*page, Box::new(core::array::from_fn(fill)));
    }
    let first = memory.entry(0).or_insert_with(|| Box::new([0; PAGE_SIZE]));
    first[INFO_OFFSET..][..INFO_LENGTH].copy_from_slice(&InfoBlock { identity }.to_bytes());
    Memory(memory)
}

fn packed(identity: Identity, pages: &[u8]) -> (Memory, Header) {
    let mut memory = plain(identity, pages);
    let mut last = Box::new([0xFF; PAGE_SIZE]);
    let header = pack(|page| memory.0.get(&page).map(|page| &**page), &mut last).unwrap();
    memory.0.insert(LAST_PAGE, last);
    (memory, header)
}

fn check(memory: &mut Memory) -> Result<Header, ImageError<()>> {
    verify(memory, |_| ())
}

#[test]
fn offsets_of_the_document() {
    let header = Header {
        identity: IDENTITY,
        pages: 0x4000_0003,
        image_crc: 0x1122_3344,
        signed: true,
    };
    let bytes = header.to_bytes(Some(&[0x5A; 64]));
    assert_eq!(&bytes[..8], b"WLHD\x01\x00\x00\x01");
    assert_eq!(bytes[0x08..0x0C], [0x03, 0x01, 0x20, 0x60]);
    assert_eq!(bytes[0x0C..0x10], [0x05, 0x04, 0, 0]);
    assert_eq!(bytes[0x10..0x14], [0x18, 0x01, 0xFF, 0xFF]);
    assert_eq!(bytes[0x14..0x18], [7, 0, 0, 0]);
    assert_eq!(bytes[0x18..0x1C], [3, 0, 0, 0x40]);
    assert_eq!(bytes[0x1C..0x20], [0x44, 0x33, 0x22, 0x11]);
    assert!(is_blank(&bytes[0x20..0x3C]));
    let mut hole = bytes;
    hole[0x3C..0x40].fill(0xFF);
    assert_eq!(bytes[0x3C..0x40], crate::crc::iso_hdlc(&hole).to_le_bytes());
    assert_eq!(bytes[0x40..0x80], [0x5A; 64]);
    assert!(is_blank(&bytes[0x80..0xFC]));
    assert_eq!(bytes[0xFC..], [0x18, 0x01, 0x00, 0xFF]);
    assert_eq!(Header::parse(&bytes), Ok(header));

    let info = InfoBlock { identity: IDENTITY };
    let bytes = info.to_bytes();
    assert_eq!(&bytes[..8], b"WLAI\x01\x00\x40\x00");
    assert_eq!(bytes[0x08..0x0C], [0x03, 0x01, 0x20, 0x60]);
    assert_eq!(bytes[0x0C..0x10], [0x05, 0x04, 0, 0]);
    assert_eq!(bytes[0x10..0x14], [0x18, 0x01, 0xFF, 0xFF]);
    assert_eq!(bytes[0x14..0x18], [7, 0, 0, 0]);
    assert!(is_blank(&bytes[0x18..0x3C]));
    assert_eq!(
        bytes[0x3C..],
        crate::crc::iso_hdlc(&bytes[..0x3C]).to_le_bytes()
    );
    assert_eq!(InfoBlock::parse(&bytes), Ok(info));
}

#[test]
fn the_image_crc_is_the_plain_crc_of_the_pages_with_the_seal_as_erased() {
    let (memory, header) = packed(IDENTITY, &[0, 1, 17]);
    assert_eq!(header.pages, 1 | 2 | 1 << 17 | 1 << 30);
    let mut bytes = Vec::new();
    for page in memory.0.values() {
        bytes.extend_from_slice(&page[..]);
    }
    let at = bytes.len() - HEADER_LENGTH;
    bytes[at + 0x1C..at + 0x20].fill(0xFF);
    bytes[at + 0x3C..at + 0x80].fill(0xFF);
    assert_eq!(header.image_crc, crate::crc::iso_hdlc(&bytes));
}

#[test]
fn a_packed_image_is_whole_and_a_signature_changes_neither_crc_nor_message() {
    let (mut memory, header) = packed(IDENTITY, &[0, 3]);
    let mut covered = Vec::new();
    let whole = verify(&mut memory, |chunk| covered.extend_from_slice(chunk)).unwrap();
    assert_eq!(whole, header);
    assert_eq!(covered.len(), 3 * PAGE_SIZE);
    assert_eq!(crate::crc::iso_hdlc(&covered), header.image_crc);
    let before = signed_message(&header, &[1; 64]);
    let last = memory.0.get_mut(&LAST_PAGE).unwrap();
    let signed = put_signature(last, [0x33; 64]).unwrap();
    assert_eq!(check(&mut memory), Ok(signed));
    assert_eq!(signed.image_crc, header.image_crc);
    assert_eq!(signed_message(&signed, &[1; 64]), before);
    assert_eq!(&before[..16], b"windlass image 1");
    assert_eq!(before[16..76], header.to_bytes(None)[..60]);
    assert_eq!(before[76..], [1; 64]);
}

#[test]
fn an_image_with_too_many_pages_for_its_hardware_is_refused() {
    let small = Identity {
        hardware: Hardware::G431.id,
        ..IDENTITY
    };
    let memory = plain(small, &[0, 22, 23, 29]);
    let mut last = [0xFF; PAGE_SIZE];
    let result = pack(|page| memory.0.get(&page).map(|page| &**page), &mut last);
    assert_eq!(result, Err(PackError::TooLarge(1 << 23 | 1 << 29)));
    assert!(is_blank(&last));
}

#[test]
fn packing_tells_what_is_missing() {
    let mut blank = [0xFF; PAGE_SIZE];
    assert_eq!(pack(|_| None, &mut blank), Err(PackError::Info(None)));
    let empty = [0xFF; PAGE_SIZE];
    assert_eq!(
        pack(|page| (page == 0).then_some(&empty), &mut blank),
        Err(PackError::Info(Some(MalformedInfo::Magic)))
    );
    let pack_with = |identity, last: &mut Page| {
        let memory = plain(identity, &[0]);
        pack(|page| memory.0.get(&page).map(|page| &**page), last)
    };
    let unknown = Identity {
        hardware: 0x0777,
        ..IDENTITY
    };
    assert_eq!(
        pack_with(unknown, &mut blank),
        Err(PackError::Hardware(0x0777))
    );
    let none = Identity {
        version: NO_VERSION,
        ..IDENTITY
    };
    assert_eq!(pack_with(none, &mut blank), Err(PackError::Version));
    let mut taken = [0xFF; PAGE_SIZE];
    taken[PAGE_SIZE - 1] = 0;
    assert_eq!(pack_with(IDENTITY, &mut taken), Err(PackError::HeaderTaken));
}

#[test]
fn each_malformation_has_a_name() {
    let bytes = Header {
        identity: IDENTITY,
        pages: REQUIRED_PAGES,
        image_crc: 0,
        signed: false,
    }
    .to_bytes(None);
    assert_eq!(Header::parse(&bytes[..255]), Err(MalformedHeader::Magic));
    assert_eq!(Header::parse(&[0xFF; 256]), Err(MalformedHeader::Magic));
    let mut newer = bytes;
    newer[4] = 2;
    assert_eq!(Header::parse(&newer), Err(MalformedHeader::Format));
    for pages in [0, 1, 1 << 30, REQUIRED_PAGES | 1 << 31] {
        let bad = Header {
            identity: IDENTITY,
            pages,
            image_crc: 0,
            signed: false,
        };
        assert_eq!(
            Header::parse(&bad.to_bytes(None)),
            Err(MalformedHeader::Content)
        );
    }
    let (mut memory, _) = packed(IDENTITY, &[0]);
    let other = Identity {
        version: 0x0119,
        ..IDENTITY
    };
    memory.0.get_mut(&0).unwrap()[INFO_OFFSET..][..INFO_LENGTH]
        .copy_from_slice(&InfoBlock { identity: other }.to_bytes());
    assert_eq!(check(&mut memory), Err(ImageError::Disagree));
}

#[test]
fn no_flipped_bit_of_header_or_information_block_is_accepted() {
    let (memory, _) = packed(IDENTITY, &[0]);
    let areas = [
        (LAST_PAGE, HEADER_OFFSET, HEADER_LENGTH),
        (FIRST_PAGE, INFO_OFFSET, INFO_LENGTH),
    ];
    for (page, offset, length) in areas {
        for bit in 0..length * 8 {
            let mut flipped = memory.clone();
            flipped.0.get_mut(&page).unwrap()[offset + bit / 8] ^= 1 << (bit % 8);
            assert!(check(&mut flipped).is_err(), "page {page}, bit {bit}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// A changed byte anywhere in the image's pages is seen.
    #[test]
    fn no_changed_byte_is_accepted(page in 0..4_usize, at in 0..PAGE_SIZE, change in 1..=255_u8) {
        let (mut memory, _) = packed(IDENTITY, &[0, 1, 2]);
        let page = [0, 1, 2, LAST_PAGE][page];
        memory.0.get_mut(&page).unwrap()[at] ^= change;
        prop_assert!(check(&mut memory).is_err());
    }

    /// I1 for the two parsers.
    #[test]
    fn i1_no_bytes_panic_the_parsers(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = Header::parse(&bytes);
        let _ = InfoBlock::parse(&bytes);
    }

    #[test]
    fn blocks_read_back_as_they_are_written(
        product: u32, hardware: u32, version in 0..NO_VERSION, rollback: u32, pages: u32, image_crc: u32,
    ) {
        let identity = Identity { product, hardware, version, rollback };
        let pages = pages & ALL_PAGES | REQUIRED_PAGES;
        let header = Header { identity, pages, image_crc, signed: false };
        prop_assert_eq!(Header::parse(&header.to_bytes(None)), Ok(header));
        let info = InfoBlock { identity };
        prop_assert_eq!(InfoBlock::parse(&info.to_bytes()), Ok(info));
    }
}
