//! Firmware files: every format gives the same image, and no damaged one is accepted.
//!
//! The random edits are a sample here; `WINDLASS_EDITS=100000 cargo test -p windlass --test
//! image_files` runs all of them.

use std::collections::BTreeSet;

use windlass::image::container::ContainerError;
use windlass::image::crf::CrfError;
use windlass::image::elf::ElfError;
use windlass::image::hex::HexError;
use windlass::image::memory::Memory;
use windlass::image::{Contents, FileError, Format, Image, Pages, elf, hex, parse};
use windlass_core::boot::image::{
    HEADER_LENGTH, HEADER_OFFSET, Hardware, Header, INFO_LENGTH, INFO_OFFSET, Identity, InfoBlock,
    LAST_PAGE, MalformedHeader, MalformedInfo, PAGE_SIZE, put_signature,
};
use windlass_core::node::PRODUCT_DMC60C;

const SLOT: u32 = 0x0802_0000;

const IDENTITY: Identity = Identity {
    product: PRODUCT_DMC60C,
    hardware: Hardware::F405.id,
    version: 0x0119,
    rollback: 3,
};

/// A generator of repeatable numbers (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        word ^ (word >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}

/// The bytes of an application of this length, without header.
fn application(identity: Identity, length: usize) -> Vec<u8> {
    let mut random = Random(length as u64);
    let mut bytes: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
    bytes[INFO_OFFSET..INFO_OFFSET + INFO_LENGTH]
        .copy_from_slice(&InfoBlock { identity }.to_bytes());
    bytes
}

fn memory(parts: &[(u32, &[u8])]) -> Memory {
    let mut memory = Memory::default();
    for (address, bytes) in parts {
        memory.add(*address, bytes).unwrap();
    }
    memory.finish().unwrap()
}

/// An ELF file as a linker makes it, with a segment for each run and something behind that is not loaded.
fn linked(memory: &Memory) -> Vec<u8> {
    let runs = memory.runs();
    let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
    for half in [2_u16, 40] {
        file.extend(half.to_le_bytes());
    }
    for word in [1_u32, runs[0].address | 1, 52, 0, 0x0500_0400] {
        file.extend(word.to_le_bytes());
    }
    for half in [52_u16, 32, runs.len() as u16, 40, 0, 0] {
        file.extend(half.to_le_bytes());
    }
    let mut at = (52 + 32 * runs.len()) as u32;
    for run in runs {
        let length = run.bytes.len() as u32;
        for word in [1, at, run.address, run.address, length, length, 5, 4] {
            file.extend(word.to_le_bytes());
        }
        at += length;
    }
    for run in runs {
        file.extend(&run.bytes);
    }
    file.extend([0xD0; 64]);
    file
}

fn image(identity: Identity, length: usize) -> Image {
    let bytes = application(identity, length);
    Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap()
}

fn small() -> Image {
    image(IDENTITY, 2 * PAGE_SIZE + 100)
}

fn open(format: Format, bytes: &[u8]) -> Result<Image, FileError> {
    parse(format, bytes).and_then(Image::sealed)
}

fn refused(format: Format, bytes: &[u8]) -> FileError {
    match open(format, bytes) {
        Ok(_) => panic!("{format:?} was accepted"),
        Err(error) => {
            assert!(!error.to_string().is_empty() && !error.next_step().is_empty());
            error
        }
    }
}

/// The same image as a file of every format.
fn sealed_files() -> (Image, Vec<(Format, Vec<u8>)>) {
    let bytes = application(IDENTITY, 2 * PAGE_SIZE + 100);
    let elf = linked(&memory(&[(SLOT, &bytes), (0x0800_0000, &[0; 8])]));
    let contents = parse(Format::Elf, &elf).unwrap();
    assert_eq!(contents.base, SLOT);
    let image = Image::packed(contents).unwrap();
    let mut files = vec![(Format::Elf, image.seal_elf(&elf, SLOT).unwrap())];
    for format in [Format::Hex, Format::Bin, Format::Container, Format::Crf] {
        files.push((format, image.write(format).unwrap()));
    }
    (image, files)
}

#[test]
fn every_format_gives_the_same_image() {
    let (image, files) = sealed_files();
    assert_eq!(image, small());
    assert_eq!(image.pages().bitmap(), 1 << 30 | 0b111);
    assert_eq!(image.header().identity, IDENTITY);
    for (format, bytes) in &files {
        assert_eq!(open(*format, bytes).unwrap(), image, "{format:?}");
    }
}

#[test]
fn what_a_linker_makes_has_no_seal_and_is_packed_on_request() {
    let bytes = application(IDENTITY, 2 * PAGE_SIZE + 100);
    let placed = memory(&[(SLOT, &bytes)]);
    for (format, file) in [
        (Format::Elf, linked(&placed)),
        (Format::Hex, hex::write(&placed).into_bytes()),
        (Format::Bin, bytes),
    ] {
        assert!(matches!(refused(format, &file), FileError::NotSealed));
        let packed = Image::packed(parse(format, &file).unwrap()).unwrap();
        assert_eq!(packed, small(), "{format:?}");
    }
}

#[test]
fn pages_beyond_30_of_a_hex_file_in_the_guide_s_form_are_left_out_with_a_notice() {
    let image = small();
    let mut pages = Memory::default();
    for (number, contents) in image.pages().iter() {
        pages.add(u32::from(number) * 0x1000, contents).unwrap();
    }
    pages.add(31 * 0x1000, &[1; 300]).unwrap();
    let file = hex::write(&pages.finish().unwrap());
    let contents = parse(Format::Hex, file.as_bytes()).unwrap();
    assert!(
        contents.notices[0].contains("300 bytes in pages beyond 30"),
        "{:?}",
        contents.notices
    );
    assert_eq!(Image::sealed(contents).unwrap(), image);
}

#[test]
fn what_stands_below_the_slot_is_left_out_with_a_notice() {
    let bytes = application(IDENTITY, PAGE_SIZE);
    let file = linked(&memory(&[(0x0800_0000, &[0; 8]), (SLOT, &bytes)]));
    let contents = parse(Format::Elf, &file).unwrap();
    assert!(
        contents.notices[0].contains("8 bytes below"),
        "{:?}",
        contents.notices
    );
    assert_eq!(contents.pages.bitmap(), 1);
}

#[test]
fn page_30_of_a_small_slot_follows_page_22() {
    let identity = Identity {
        hardware: Hardware::G431.id,
        ..IDENTITY
    };
    let bytes = application(identity, 23 * PAGE_SIZE);
    let file = linked(&memory(&[(0x0800_7000, &bytes)]));
    let contents = parse(Format::Elf, &file).unwrap();
    let image = Image::packed(contents).unwrap();
    assert_eq!(image.pages().bitmap(), 1 << 30 | ((1 << 23) - 1));
    let sealed = image.seal_elf(&file, 0x0800_7000).unwrap();
    assert_eq!(open(Format::Elf, &sealed).unwrap(), image);
    let binary = image.write(Format::Bin).unwrap();
    assert_eq!(binary.len(), 24 * PAGE_SIZE);
    assert_eq!(open(Format::Bin, &binary).unwrap(), image);
    let guide = image.write(Format::Hex).unwrap();
    assert_eq!(open(Format::Hex, &guide).unwrap(), image);
    let large = application(identity, 24 * PAGE_SIZE + 1);
    let error = refused(Format::Elf, &linked(&memory(&[(0x0800_7000, &large)])));
    assert!(matches!(error, FileError::BeyondSlot { .. }), "{error}");
}

#[test]
fn no_flipped_bit_of_header_information_block_or_signature_is_accepted() {
    let key = ed25519_dalek::SigningKey::from_bytes(&[7; 32]);
    let image = small().signed(&key);
    assert_eq!(image.verify_signature(&key.verifying_key()), Some(true));
    let elf = linked(&memory(&[(
        SLOT,
        &application(IDENTITY, 2 * PAGE_SIZE + 100),
    )]));
    let header = image.pages().get(LAST_PAGE).unwrap()[HEADER_OFFSET..].to_vec();
    let info = InfoBlock { identity: IDENTITY }.to_bytes();
    for (format, file) in [
        (Format::Container, image.write(Format::Container).unwrap()),
        (Format::Crf, image.write(Format::Crf).unwrap()),
        (Format::Bin, image.write(Format::Bin).unwrap()),
        (Format::Elf, image.seal_elf(&elf, SLOT).unwrap()),
    ] {
        let mut flipped = 0;
        for block in [&header[..], &info[..]] {
            let at = file
                .windows(block.len())
                .position(|bytes| bytes == block)
                .unwrap();
            for bit in 0..block.len() * 8 {
                let mut damaged = file.clone();
                damaged[at + bit / 8] ^= 1 << (bit % 8);
                refused(format, &damaged);
                flipped += 1;
            }
        }
        assert_eq!(flipped, (HEADER_LENGTH + INFO_LENGTH) * 8);
    }
}

#[test]
fn no_flipped_bit_of_a_container_s_header_or_trailer_is_accepted() {
    let (_, files) = sealed_files();
    for (format, file) in &files {
        let bytes = match format {
            Format::Container => 28 + 4 * 4 + 4,
            Format::Crf => 28 + 16,
            _ => continue,
        };
        for bit in 0..bytes * 8 {
            let mut damaged = file.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            refused(*format, &damaged);
        }
        let last = file.len() - 1;
        for bit in 0..8 {
            let mut damaged = file.clone();
            damaged[last] ^= 1 << bit;
            refused(*format, &damaged);
        }
    }
}

/// One random edit: flips, overwrites, removes, inserts, repeats or cuts.
fn edit(random: &mut Random, file: &[u8]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    let at = random.below(bytes.len());
    let span = 1 + random.below(40);
    let end = (at + span).min(bytes.len());
    match random.below(7) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at..end].fill_with(|| random.next() as u8),
        2 => drop(bytes.drain(at..end)),
        3 => {
            let new: Vec<u8> = (0..span).map(|_| random.next() as u8).collect();
            bytes.splice(at..at, new);
        }
        4 => {
            let again = bytes[at..end].to_vec();
            bytes.splice(at..at, again);
        }
        5 => bytes.truncate(at),
        _ => {
            let other = random.below(bytes.len());
            bytes.swap(at, other);
        }
    }
    bytes
}

/// An edit of whole lines, which leaves every HEX record as it is: one is removed, repeated or moved.
fn edit_lines(random: &mut Random, file: &[u8]) -> Vec<u8> {
    let mut lines: Vec<&[u8]> = file.split_inclusive(|byte| *byte == b'\n').collect();
    let at = random.below(lines.len());
    let line = lines[at];
    match random.below(3) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(at, line),
        _ => {
            let other = random.below(lines.len());
            lines.swap(at, other);
        }
    }
    lines.concat()
}

#[test]
fn no_random_edit_is_accepted() {
    let edits: usize = match std::env::var("WINDLASS_EDITS") {
        Ok(text) => text.parse().expect("WINDLASS_EDITS is a number"),
        Err(_) => 1500,
    };
    let (image, files) = sealed_files();
    for (format, file) in &files {
        let mut random = Random(*format as u64);
        let mut unchanged = 0;
        for index in 0..edits {
            let damaged = match (format, index % 4) {
                (Format::Hex, 0) => edit_lines(&mut random, file),
                _ => edit(&mut random, file),
            };
            match open(*format, &damaged) {
                Err(error) => assert!(!error.next_step().is_empty()),
                // An edit may leave what is loaded as it is: letter case, debug information.
                Ok(same) => {
                    assert_eq!(same, image, "{format:?}, edit {index}");
                    unchanged += 1;
                }
            }
        }
        println!(
            "{}: {edits} edits, {unchanged} of them without effect",
            format.name()
        );
        assert!(unchanged < edits / 3, "{format:?}: {unchanged}");
    }
}

#[test]
fn no_truncated_file_is_accepted() {
    let (image, files) = sealed_files();
    for (format, file) in &files {
        let step = if *format == Format::Hex { 7 } else { 61 };
        for length in (0..file.len()).step_by(step) {
            // Debug information may be missing behind, and so may a last line feed.
            if let Ok(same) = open(*format, &file[..length]) {
                assert_eq!(same, image);
                assert!(length + 64 > file.len(), "{format:?} cut to {length}");
            }
        }
    }
}

/// Every kind of damage with its own message.
#[test]
fn each_kind_of_damage_has_a_distinct_message() {
    let image = small();
    let container = image.write(Format::Container).unwrap();
    let crf = image.write(Format::Crf).unwrap();
    let raw = application(IDENTITY, PAGE_SIZE);
    let elf = linked(&memory(&[(SLOT, &raw)]));
    let changed = |file: &[u8], at: usize, bytes: &[u8]| {
        let mut copy = file.to_vec();
        copy[at..at + bytes.len()].copy_from_slice(bytes);
        copy
    };
    let sealed_crf = |file: Vec<u8>| {
        let crc = windlass_core::crc::iso_hdlc(&file[..24]).to_le_bytes();
        changed(&file, 24, &crc)
    };
    let section = |file: Vec<u8>| {
        let crc = windlass_core::crc::iso_hdlc(&file[28..40]).to_le_bytes();
        changed(&file, 40, &crc)
    };
    let errors = [
        refused(Format::Container, &[]),
        refused(Format::Container, &changed(&container, 0, b"X")),
        refused(Format::Container, &changed(&container, 8, &[2])),
        refused(Format::Container, &container[..100]),
        refused(Format::Container, &changed(&container, 16, &[0])),
        refused(Format::Container, &changed(&container, 24, &[0xF7])),
        refused(Format::Container, &changed(&container, 100, &[1, 2, 3])),
        refused(Format::Crf, &changed(&crf, 0, b"X")),
        refused(Format::Crf, &crf[..200]),
        refused(Format::Crf, &sealed_crf(changed(&crf, 12, &[9]))),
        refused(Format::Crf, &sealed_crf(changed(&crf, 20, &[0]))),
        refused(Format::Crf, &changed(&crf, 28, &[1])),
        refused(Format::Crf, &section(changed(&crf, 32, &[1]))),
        refused(Format::Crf, &changed(&crf, 100, &[1, 2, 3])),
        refused(Format::Elf, &elf[..40]),
        refused(Format::Elf, &changed(&elf, 5, &[2])),
        refused(Format::Elf, &changed(&elf, 18, &[3])),
        refused(Format::Elf, &changed(&elf, 16, &[3])),
        refused(Format::Elf, &changed(&elf, 28, &[0xFF; 4])),
        refused(Format::Elf, &changed(&elf, 44, &[65, 0])),
        refused(Format::Elf, &elf[..elf.len() - 70]),
        refused(Format::Elf, &changed(&elf, 52 + 20, &[0; 4])),
        refused(Format::Elf, &changed(&elf, 52, &[0])),
        refused(Format::Elf, &elf),
        refused(Format::Elf, &linked(&memory(&[(SLOT, &[1; 5000])]))),
        refused(Format::Bin, &changed(&raw, INFO_OFFSET + 20, &[1])),
        refused(Format::Bin, &changed(&raw, INFO_OFFSET + 4, &[9])),
        refused(Format::Bin, &application(IDENTITY, 31 * PAGE_SIZE)),
        refused(Format::Bin, &vec![0; 32 * PAGE_SIZE]),
        refused(Format::Hex, b":00000001FF"),
    ];
    let texts: BTreeSet<String> = errors
        .iter()
        .map(|error| {
            error
                .to_string()
                .replace(|letter: char| letter.is_ascii_digit(), "")
        })
        .collect();
    assert_eq!(texts.len(), errors.len(), "{texts:#?}");
    for (index, fits) in [
        matches!(errors[0], FileError::Empty),
        matches!(errors[1], FileError::Container(ContainerError::BadMagic)),
        matches!(
            errors[2],
            FileError::Container(ContainerError::UnknownFormat(2))
        ),
        matches!(
            errors[3],
            FileError::Container(ContainerError::Length { .. })
        ),
        matches!(errors[4], FileError::Container(ContainerError::HeaderCrc)),
        matches!(errors[5], FileError::Container(ContainerError::BadPages)),
        matches!(errors[6], FileError::Container(ContainerError::PageCrc(0))),
        matches!(errors[7], FileError::Crf(CrfError::BadHeader(_))),
        matches!(errors[8], FileError::Crf(CrfError::FileSize { .. })),
        matches!(errors[9], FileError::Crf(CrfError::WrongProduct { .. })),
        matches!(errors[10], FileError::Crf(CrfError::NoSections)),
        matches!(
            errors[11],
            FileError::Crf(CrfError::BadSectionHeader { .. })
        ),
        matches!(errors[12], FileError::Crf(CrfError::BadSectionSize { .. })),
        matches!(errors[13], FileError::Crf(CrfError::SectionCrc { .. })),
        matches!(errors[14], FileError::Elf(ElfError::BadHeader)),
        matches!(errors[15], FileError::Elf(ElfError::BigEndian)),
        matches!(errors[16], FileError::Elf(ElfError::WrongMachine(3))),
        matches!(errors[17], FileError::Elf(ElfError::NotExecutable(3))),
        matches!(errors[18], FileError::Elf(ElfError::BadProgramHeaders)),
        matches!(errors[19], FileError::Elf(ElfError::TooManySegments(65))),
        matches!(
            errors[20],
            FileError::Elf(ElfError::SegmentOutside { index: 0 })
        ),
        matches!(
            errors[21],
            FileError::Elf(ElfError::SegmentSize { index: 0 })
        ),
        matches!(errors[22], FileError::Elf(ElfError::NoData)),
        matches!(errors[23], FileError::NotSealed),
        matches!(errors[24], FileError::NoApplication),
        matches!(errors[25], FileError::Info(MalformedInfo::Crc)),
        matches!(errors[26], FileError::Info(MalformedInfo::Format)),
        matches!(errors[27], FileError::Header(MalformedHeader::Magic)),
        matches!(errors[28], FileError::TooLong(_)),
        matches!(errors[29], FileError::Hex(HexError::NoData)),
    ]
    .into_iter()
    .enumerate()
    {
        assert!(fits, "{index}: {}", errors[index]);
    }
    let codes: Vec<Option<i32>> = errors[7..14]
        .iter()
        .map(|error| match error {
            FileError::Crf(error) => error.code(),
            _ => None,
        })
        .collect();
    assert_eq!(codes[..6], [-200, -201, -202, -203, -204, -205].map(Some));
}

#[test]
fn applications_that_cannot_be_packed_are_told_apart() {
    let pack = |identity: Identity, length: usize| {
        let bytes = application(identity, length);
        parse(Format::Bin, &bytes)
            .and_then(Image::packed)
            .unwrap_err()
    };
    let unknown = pack(
        Identity {
            hardware: 0x777,
            ..IDENTITY
        },
        PAGE_SIZE,
    );
    assert!(matches!(unknown, FileError::Hardware(0x777)), "{unknown}");
    let none = pack(
        Identity {
            version: 0xFFFF,
            ..IDENTITY
        },
        PAGE_SIZE,
    );
    assert!(matches!(none, FileError::Version), "{none}");
    let taken = pack(IDENTITY, 31 * PAGE_SIZE);
    assert!(matches!(taken, FileError::Header(_)), "{taken}");
    let twice = memory(&[
        (SLOT, &application(IDENTITY, PAGE_SIZE)),
        (SLOT + 0x2_0000, &application(IDENTITY, PAGE_SIZE)),
    ]);
    let twice = refused(Format::Elf, &linked(&twice));
    assert!(
        matches!(twice, FileError::Several(SLOT, 0x0804_0000)),
        "{twice}"
    );
    let beyond = memory(&[
        (SLOT, &application(IDENTITY, PAGE_SIZE)),
        (SLOT + 0x1_F000, &[1]),
    ]);
    let beyond = refused(Format::Hex, hex::write(&beyond).as_bytes());
    assert!(
        matches!(
            beyond,
            FileError::BeyondSlot {
                address: 0x0803_F000,
                ..
            }
        ),
        "{beyond}"
    );
}

#[test]
fn a_signature_fits_one_image_and_one_key() {
    let key = ed25519_dalek::SigningKey::from_bytes(&[7; 32]);
    let other = ed25519_dalek::SigningKey::from_bytes(&[8; 32]);
    let plain = small();
    assert_eq!(plain.verify_signature(&key.verifying_key()), None);
    let signed = plain.clone().signed(&key);
    assert_eq!(signed.verify_signature(&key.verifying_key()), Some(true));
    assert_eq!(signed.verify_signature(&other.verifying_key()), Some(false));
    let again = signed.clone().signed(&other);
    assert_eq!(again.verify_signature(&other.verifying_key()), Some(true));
    // Another image of the same identity with this signature.
    let mut longer = image(IDENTITY, 2 * PAGE_SIZE + 101);
    assert_eq!(longer.header().pages, signed.header().pages);
    let mut pages: Pages = longer.pages().clone();
    let last = signed.pages().get(LAST_PAGE).unwrap();
    let signature = Header::signature(last.last_chunk().unwrap());
    let mut last = *pages.get(LAST_PAGE).unwrap();
    put_signature(&mut last, signature).unwrap();
    assert!(pages.put(LAST_PAGE, 0, &last));
    let contents = Contents {
        format: Format::Bin,
        pages,
        base: 0,
        notices: Vec::new(),
    };
    longer = Image::sealed(contents).unwrap();
    assert_eq!(longer.verify_signature(&key.verifying_key()), Some(false));
}

#[test]
fn a_segment_is_not_added_over_another() {
    let file = linked(&memory(&[(SLOT, &application(IDENTITY, PAGE_SIZE))]));
    let error = elf::with_segment(&file, SLOT + 100, &[1]).unwrap_err();
    assert!(matches!(error, ElfError::Memory(_)), "{error}");
}
