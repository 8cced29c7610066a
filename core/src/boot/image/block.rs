//! The two blocks that tell what an image is: [`InfoBlock`] in page 0 and [`Header`] at the end of page 30.

use super::seal::is_blank;
use super::{ALL_PAGES, PAGE_SIZE, REQUIRED_PAGES};
use crate::crc::Crc32;

/// Offset of the information block in page 0: behind the longest vector table of the supported
/// microcontrollers (STM32G474: 16 + 102 vectors, 472 bytes), at the alignment that `VTOR` asks for.
pub const INFO_OFFSET: usize = 0x200;
/// Bytes of the information block.
pub const INFO_LENGTH: usize = 64;
/// First bytes of the information block.
pub const INFO_MAGIC: [u8; 4] = *b"WLAI";
/// Its format.
pub const INFO_FORMAT: u16 = 1;

/// Bytes of the header.
pub const HEADER_LENGTH: usize = 256;
/// Offset of the header in page 30.
pub const HEADER_OFFSET: usize = PAGE_SIZE - HEADER_LENGTH;
/// First bytes of the header.
pub const HEADER_MAGIC: [u8; 4] = *b"WLHD";
/// Its format.
pub const HEADER_FORMAT: u16 = 1;
/// Bytes of the header that a signature covers directly, from its first byte on.
pub const SIGNED_LENGTH: usize = 60;
/// Bytes of an Ed25519 signature (RFC 8032).
pub const SIGNATURE_LENGTH: usize = 64;
/// What stands in the place of the signature of an image that has none.
pub const UNSIGNED_SIGNATURE: [u8; SIGNATURE_LENGTH] = [0xFF; SIGNATURE_LENGTH];

/// The version that means that there is no application (guide, `fwverApp`); no image may have it.
pub const NO_VERSION: u16 = 0xFFFF;

/// Offsets that both blocks share: they begin alike, and the CRC of either covers all of the block but itself.
mod at {
    pub(super) const FORMAT: usize = 0x04;
    pub(super) const LENGTH: usize = 0x06;
    pub(super) const IDENTITY: usize = 0x08;
    pub(super) const CRC: usize = super::SIGNED_LENGTH;
}

/// Offsets in the header alone.
pub(super) mod header_at {
    pub(in super::super) const PAGES: usize = 0x18;
    pub(in super::super) const IMAGE_CRC: usize = 0x1C;
    pub(in super::super) const HEADER_CRC: usize = super::at::CRC;
    pub(in super::super) const SIGNATURE: usize = 0x40;
    pub(in super::super) const VERSION: usize = 0xFC;
}

/// What an image is made for and which one it is: 16 bytes that information block and header share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Product id (`pdid`), see [`PRODUCT_DMC60C`](crate::node::PRODUCT_DMC60C).
    pub product: u32,
    /// Hardware id, see [`Hardware`](super::Hardware).
    pub hardware: u32,
    /// Application version, major and minor byte (`fwverApp`); never [`NO_VERSION`].
    pub version: u16,
    /// Anti-rollback counter: once a controller has confirmed an image, it refuses images with a
    /// smaller one.
    pub rollback: u32,
}

impl Identity {
    const fn to_bytes(self) -> [u8; 16] {
        let [p0, p1, p2, p3] = self.product.to_le_bytes();
        let [h0, h1, h2, h3] = self.hardware.to_le_bytes();
        let [v0, v1] = self.version.to_le_bytes();
        let [r0, r1, r2, r3] = self.rollback.to_le_bytes();
        [
            p0, p1, p2, p3, h0, h1, h2, h3, v0, v1, 0xFF, 0xFF, r0, r1, r2, r3,
        ]
    }

    const fn from_bytes(
        [p0, p1, p2, p3, h0, h1, h2, h3, v0, v1, _, _, r0, r1, r2, r3]: [u8; 16],
    ) -> Self {
        Self {
            product: u32::from_le_bytes([p0, p1, p2, p3]),
            hardware: u32::from_le_bytes([h0, h1, h2, h3]),
            version: u16::from_le_bytes([v0, v1]),
            rollback: u32::from_le_bytes([r0, r1, r2, r3]),
        }
    }
}

/// The block at [`INFO_OFFSET`] of page 0: the application tells what it is, so that an ELF or BIN file can
/// be packed without further knowledge and the application knows its own version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InfoBlock {
    /// Product, hardware, version and anti-rollback counter.
    pub identity: Identity,
}

/// Why bytes are no information block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MalformedInfo {
    /// They do not begin with [`INFO_MAGIC`], or there are too few.
    Magic,
    /// Another format or length.
    Format,
    /// The CRC is wrong.
    Crc,
}

impl InfoBlock {
    /// The block as an application places it; `const`, so that it can be a static.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; INFO_LENGTH] {
        let mut bytes = begun(INFO_MAGIC, INFO_FORMAT, self.identity);
        let crc = crc_of(&bytes);
        put(&mut bytes, at::CRC, &crc.to_le_bytes());
        bytes
    }

    /// Reads the block from its first 64 bytes.
    ///
    /// # Errors
    /// See [`MalformedInfo`].
    pub fn parse(bytes: &[u8]) -> Result<Self, MalformedInfo> {
        let bytes = bytes
            .first_chunk::<INFO_LENGTH>()
            .ok_or(MalformedInfo::Magic)?;
        match opened(
            bytes,
            INFO_MAGIC,
            INFO_FORMAT,
            INFO_LENGTH,
            begun_crc(bytes),
        ) {
            Ok(identity) => Ok(Self { identity }),
            Err(Flaw::Magic) => Err(MalformedInfo::Magic),
            Err(Flaw::Format) => Err(MalformedInfo::Format),
            Err(Flaw::Crc) => Err(MalformedInfo::Crc),
        }
    }
}

/// The last [`HEADER_LENGTH`] bytes of page 30.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Product, hardware, version and anti-rollback counter.
    pub identity: Identity,
    /// Pages that belong to the image, bit 0 = page 0; every other page of the slot is erased.
    pub pages: u32,
    /// CRC over these pages, see [`ImageCrc`](super::ImageCrc).
    pub image_crc: u32,
    /// An Ed25519 signature of [`signed_message`](super::signed_message) follows, see [`Header::signature`].
    pub signed: bool,
}

/// Why bytes are no header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MalformedHeader {
    /// They do not begin with [`HEADER_MAGIC`], or there are too few: no image of this project.
    Magic,
    /// Another format or length: made by a newer tool.
    Format,
    /// The header's CRC is wrong.
    Crc,
    /// The CRC is right, but the page bitmap lacks page 0 or 30 or has bits beyond, the version is
    /// [`NO_VERSION`], or the last four bytes tell another version.
    Content,
}

impl Header {
    /// The header as it stands at [`HEADER_OFFSET`] of page 30, with this signature or without one.
    #[must_use]
    pub fn to_bytes(&self, signature: Option<&[u8; SIGNATURE_LENGTH]>) -> [u8; HEADER_LENGTH] {
        let mut bytes = begun(HEADER_MAGIC, HEADER_FORMAT, self.identity);
        put(&mut bytes, header_at::PAGES, &self.pages.to_le_bytes());
        put(
            &mut bytes,
            header_at::IMAGE_CRC,
            &self.image_crc.to_le_bytes(),
        );
        if let Some(signature) = signature {
            put(&mut bytes, header_at::SIGNATURE, signature);
        }
        put(&mut bytes, header_at::VERSION, &self.version_word());
        let crc = crc_of(&bytes);
        put(&mut bytes, at::CRC, &crc.to_le_bytes());
        bytes
    }

    /// Reads the header from its 256 bytes.
    ///
    /// # Errors
    /// See [`MalformedHeader`].
    pub fn parse(bytes: &[u8]) -> Result<Self, MalformedHeader> {
        let bytes = bytes
            .first_chunk::<HEADER_LENGTH>()
            .ok_or(MalformedHeader::Magic)?;
        let mut pieces = HeaderPieces::new();
        for piece in bytes.as_chunks().0 {
            pieces.take(piece);
        }
        pieces.header()
    }

    /// The signature in a header's bytes; [`UNSIGNED_SIGNATURE`] if there is none.
    #[must_use]
    pub fn signature(bytes: &[u8; HEADER_LENGTH]) -> [u8; SIGNATURE_LENGTH] {
        take(bytes, header_at::SIGNATURE)
    }

    /// The last four bytes of page 30, where the guide puts the application's version: one instruction of
    /// 24 bits with its padding of 0xFF.
    const fn version_word(&self) -> [u8; 4] {
        let [low, high] = self.identity.version.to_le_bytes();
        [low, high, 0x00, 0xFF]
    }
}

/// Bytes of a header's piece: the first has all fields but the version word, the second is the signature.
pub(super) const PIECE: usize = INFO_LENGTH;

/// Reads a header from its pieces, in their order: where memory is short, never all of it has to be there.
pub(super) struct HeaderPieces {
    fields: [u8; PIECE],
    taken: usize,
    signed: bool,
    version_word: [u8; 4],
    crc: Crc32,
}

impl HeaderPieces {
    pub(super) const fn new() -> Self {
        Self {
            fields: [0; PIECE],
            taken: 0,
            signed: false,
            version_word: [0; 4],
            crc: Crc32::new(),
        }
    }

    #[inline(never)]
    pub(super) fn take(&mut self, piece: &[u8; PIECE]) {
        if self.taken == 0 {
            self.fields = *piece;
            self.crc = begun_crc(piece);
            self.crc.update(&[0xFF; 4]);
        } else {
            self.crc.update(piece);
        }
        if self.taken == header_at::SIGNATURE {
            self.signed = !is_blank(piece);
        }
        self.version_word = take(piece, PIECE - 4);
        self.taken += PIECE;
    }

    /// The header once all pieces have been taken.
    #[inline(never)]
    pub(super) fn header(&self) -> Result<Header, MalformedHeader> {
        let fields = &self.fields;
        let identity =
            opened(fields, HEADER_MAGIC, HEADER_FORMAT, self.taken, self.crc).map_err(|flaw| {
                match flaw {
                    Flaw::Magic => MalformedHeader::Magic,
                    Flaw::Format => MalformedHeader::Format,
                    Flaw::Crc => MalformedHeader::Crc,
                }
            })?;
        let header = Header {
            identity,
            pages: u32::from_le_bytes(take(fields, header_at::PAGES)),
            image_crc: u32::from_le_bytes(take(fields, header_at::IMAGE_CRC)),
            signed: self.signed,
        };
        let sound = header.pages & REQUIRED_PAGES == REQUIRED_PAGES
            && header.pages & !ALL_PAGES == 0
            && header.identity.version != NO_VERSION
            && self.version_word == header.version_word();
        if sound {
            Ok(header)
        } else {
            Err(MalformedHeader::Content)
        }
    }
}

/// What can be wrong with either block.
#[derive(Clone, Copy)]
enum Flaw {
    Magic,
    Format,
    Crc,
}

/// A block without its CRC and what only a header has.
const fn begun<const N: usize>(magic: [u8; 4], format: u16, identity: Identity) -> [u8; N] {
    let mut bytes = [0xFF; N];
    put(&mut bytes, 0, &magic);
    put(&mut bytes, at::FORMAT, &format.to_le_bytes());
    put(&mut bytes, at::LENGTH, &(N as u16).to_le_bytes());
    put(&mut bytes, at::IDENTITY, &identity.to_bytes());
    bytes
}

/// The CRC over what stands before the CRC.
fn begun_crc(fields: &[u8; PIECE]) -> Crc32 {
    let mut crc = Crc32::new();
    crc.update(fields.get(..at::CRC).unwrap_or(fields));
    crc
}

/// Checks what both blocks share: their first 64 bytes, and length and CRC of all of them.
fn opened(
    fields: &[u8; PIECE],
    magic: [u8; 4],
    format: u16,
    length: usize,
    crc: Crc32,
) -> Result<Identity, Flaw> {
    if take(fields, 0) != magic {
        return Err(Flaw::Magic);
    }
    if u16::from_le_bytes(take(fields, at::FORMAT)) != format
        || usize::from(u16::from_le_bytes(take(fields, at::LENGTH))) != length
    {
        return Err(Flaw::Format);
    }
    if u32::from_le_bytes(take(fields, at::CRC)) != crc.finish() {
        return Err(Flaw::Crc);
    }
    Ok(Identity::from_bytes(take(fields, at::IDENTITY)))
}

/// CRC-32/ISO-HDLC of a block with its four bytes at [`at::CRC`] taken as 0xFF. In a block that ends with them (the
/// information block) these four bytes are not taken at all.
// The index is bounded by the loop.
#[allow(clippy::indexing_slicing)]
const fn crc_of(bytes: &[u8]) -> u32 {
    const AFTER: usize = at::CRC + 4;
    let mut crc = Crc32::new();
    let end = if bytes.len() == AFTER {
        at::CRC
    } else {
        bytes.len()
    };
    let mut place = 0;
    while place < end && place < bytes.len() {
        let in_hole = place >= at::CRC && place < AFTER;
        crc.push(if in_hole { 0xFF } else { bytes[place] });
        place += 1;
    }
    crc.finish()
}

/// Copies `from` into `to` at `at`; what would stand beyond the end is dropped.
// The indices are bounded by the loop.
#[allow(clippy::indexing_slicing)]
const fn put<const N: usize, const M: usize>(to: &mut [u8; N], at: usize, from: &[u8; M]) {
    let mut index = 0;
    while index < M && at + index < N {
        to[at + index] = from[index];
        index += 1;
    }
}

/// `M` bytes from `at` on, which is a constant: inlined this is a load. Bytes beyond the end read as 0xFF, like
/// erased flash.
#[inline(always)]
fn take<const M: usize, const N: usize>(bytes: &[u8; N], at: usize) -> [u8; M] {
    let part = bytes.get(at..).and_then(|rest| rest.first_chunk());
    part.copied().unwrap_or([0xFF; M])
}
