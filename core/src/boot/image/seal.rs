//! Packing and checking whole images, the same code in the host's tool and in the bootloader.

use super::block::{HeaderPieces, PIECE, header_at};
use super::{
    ALL_PAGES, FIRST_PAGE, HEADER_LENGTH, HEADER_OFFSET, Hardware, Header, INFO_LENGTH,
    INFO_OFFSET, Identity, InfoBlock, LAST_PAGE, MalformedHeader, MalformedInfo, NO_VERSION,
    PAGE_SIZE, Page, REQUIRED_PAGES, SIGNATURE_LENGTH, SIGNED_LENGTH, pages_of,
};
use crate::crc::Crc32;

/// Bytes that are read at one time: few, because they stand on the bootloader's stack. The header begins with one.
const CHUNK: usize = 64;
const _: () = assert!(HEADER_OFFSET.is_multiple_of(CHUNK));

/// True if the image's CRC covers the byte at `offset` of `page` as it is; false for the CRC and signature
/// fields of the header, which count as 0xFF.
#[must_use]
pub const fn is_covered(page: u8, offset: usize) -> bool {
    const CRC: usize = HEADER_OFFSET + header_at::IMAGE_CRC;
    const SEAL: usize = HEADER_OFFSET + header_at::HEADER_CRC;
    const SEAL_END: usize = HEADER_OFFSET + header_at::SIGNATURE + SIGNATURE_LENGTH;
    page != LAST_PAGE || !(offset >= CRC && offset < CRC + 4 || offset >= SEAL && offset < SEAL_END)
}

/// The CRC over an image while it is being computed: CRC-32/ISO-HDLC over all bytes of its pages in
/// ascending order, with the header's own CRC and signature fields taken as 0xFF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageCrc(Crc32);

impl ImageCrc {
    /// Takes bytes of `page` that begin at `offset`; pages ascending, and each page from its first byte to
    /// its last.
    pub fn update(&mut self, page: u8, offset: usize, bytes: &[u8]) {
        if page != LAST_PAGE || offset + bytes.len() <= HEADER_OFFSET {
            return self.0.update(bytes);
        }
        for (byte, at) in bytes.iter().zip(offset..) {
            self.0.push(if is_covered(page, at) { *byte } else { 0xFF });
        }
    }

    /// The CRC.
    #[must_use]
    pub const fn finish(self) -> u32 {
        self.0.finish()
    }
}

/// Pages that can be read in pieces: a slot of flash, or an image in a host's memory.
pub trait ReadPages {
    /// Why reading failed.
    type Error;

    /// Reads bytes of `page` from `offset` on.
    ///
    /// # Errors
    /// Whatever the memory says; also for a page that it has no room for.
    fn read(&mut self, page: u8, offset: usize, bytes: &mut [u8]) -> Result<(), Self::Error>;
}

/// Why an image is not whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageError<E> {
    /// A page could not be read.
    Read(E),
    /// The header is none.
    Header(MalformedHeader),
    /// The information block of page 0 is none.
    Info(MalformedInfo),
    /// Information block and header tell different things.
    Disagree,
    /// The CRC over the pages is not the header's.
    Crc,
}

/// Checks everything about an image that can be checked without a key, and gives its header. `covered` is
/// handed the bytes that the CRC and the signature cover, piece by piece in their order.
///
/// # Errors
/// See [`ImageError`].
pub fn verify<P: ReadPages>(
    pages: &mut P,
    covered: impl FnMut(&[u8]),
) -> Result<Header, ImageError<P::Error>> {
    let header = read_header(pages)?;
    if read_identity(pages)? != header.identity {
        return Err(ImageError::Disagree);
    }
    if crc_of(pages, header.pages, covered).map_err(ImageError::Read)? == header.image_crc {
        Ok(header)
    } else {
        Err(ImageError::Crc)
    }
}

/// The identity that the information block tells. Not inlined, like what follows: the bytes that are read are on the
/// stack only while they are needed.
#[inline(never)]
fn read_identity<P: ReadPages>(pages: &mut P) -> Result<Identity, ImageError<P::Error>> {
    let mut info = [0; INFO_LENGTH];
    pages
        .read(FIRST_PAGE, INFO_OFFSET, &mut info)
        .map_err(ImageError::Read)?;
    let info = InfoBlock::parse(&info).map_err(ImageError::Info)?;
    Ok(info.identity)
}

/// The CRC over the pages of a bitmap.
#[inline(never)]
fn crc_of<P: ReadPages>(
    pages: &mut P,
    bitmap: u32,
    mut covered: impl FnMut(&[u8]),
) -> Result<u32, P::Error> {
    let mut crc = Crc32::new();
    let mut chunk = [0; CHUNK];
    for page in pages_of(bitmap) {
        for offset in (0..PAGE_SIZE).step_by(CHUNK) {
            pages.read(page, offset, &mut chunk)?;
            if page == LAST_PAGE && offset >= HEADER_OFFSET {
                mask(&mut chunk, offset);
            }
            crc.update(&chunk);
            covered(&chunk);
        }
    }
    Ok(crc.finish())
}

/// Replaces what the CRC does not cover by 0xFF.
fn mask(chunk: &mut [u8; CHUNK], offset: usize) {
    for (byte, at) in chunk.iter_mut().zip(offset..) {
        if !is_covered(LAST_PAGE, at) {
            *byte = 0xFF;
        }
    }
}

/// The header of an image, checked as far as it goes alone.
#[inline(never)]
pub(in crate::boot) fn read_header<P: ReadPages>(
    pages: &mut P,
) -> Result<Header, ImageError<P::Error>> {
    let mut pieces = HeaderPieces::new();
    let mut piece = [0; PIECE];
    for offset in (HEADER_OFFSET..PAGE_SIZE).step_by(PIECE) {
        pages
            .read(LAST_PAGE, offset, &mut piece)
            .map_err(ImageError::Read)?;
        pieces.take(&piece);
    }
    pieces.header().map_err(ImageError::Header)
}

/// Why pages cannot be packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackError {
    /// Page 0 is missing or has no information block; holds what is wrong with it, nothing if the page is
    /// missing.
    Info(Option<MalformedInfo>),
    /// The information block names a hardware that is not in [`Hardware::TABLE`]; holds its id.
    Hardware(u32),
    /// Pages that this hardware has no room for; holds them as a bitmap.
    TooLarge(u32),
    /// Something stands in the last 256 bytes of page 30, where the header goes.
    HeaderTaken,
    /// The version is [`NO_VERSION`].
    Version,
}

/// True if all bytes are as erased flash has them.
#[must_use]
pub fn is_blank(bytes: &[u8]) -> bool {
    bytes.iter().all(|byte| *byte == 0xFF)
}

/// Makes the header of an image and writes it to the end of `last`, which is page 30 as the image has it:
/// all 0xFF if nothing stands in it. `page` gives the other pages, those that belong to the image and no
/// more. What the image is comes from the information block of its page 0.
///
/// An image that has a header already is packed again by blanking its last [`HEADER_LENGTH`] bytes before.
///
/// # Errors
/// See [`PackError`].
pub fn pack<'a>(
    page: impl Fn(u8) -> Option<&'a Page>,
    last: &mut Page,
) -> Result<Header, PackError> {
    let first = page(FIRST_PAGE).ok_or(PackError::Info(None))?;
    let info = InfoBlock::parse(first.get(INFO_OFFSET..).unwrap_or(&[]))
        .map_err(|error| PackError::Info(Some(error)))?;
    let identity: Identity = info.identity;
    if identity.version == NO_VERSION {
        return Err(PackError::Version);
    }
    let hardware =
        Hardware::from_id(identity.hardware).ok_or(PackError::Hardware(identity.hardware))?;
    let present = pages_of(ALL_PAGES).filter(|number| page(*number).is_some());
    let bitmap = present.fold(REQUIRED_PAGES, |bitmap, number| bitmap | 1 << number);
    let beyond = bitmap & !hardware.pages;
    if beyond != 0 {
        return Err(PackError::TooLarge(beyond));
    }
    if !is_blank(last.get(HEADER_OFFSET..).unwrap_or(&[])) {
        return Err(PackError::HeaderTaken);
    }
    let mut header = Header {
        identity,
        pages: bitmap,
        image_crc: 0,
        signed: false,
    };
    put_header(last, &header, None);
    let mut crc = ImageCrc::default();
    for number in pages_of(bitmap & !(1 << LAST_PAGE)) {
        crc.update(number, 0, page(number).map_or(&[], |page| &page[..]));
    }
    crc.update(LAST_PAGE, 0, last);
    header.image_crc = crc.finish();
    put_header(last, &header, None);
    Ok(header)
}

/// Gives page 30 of a packed image this signature.
///
/// # Errors
/// The page has no header.
pub fn put_signature(
    last: &mut Page,
    signature: [u8; SIGNATURE_LENGTH],
) -> Result<Header, MalformedHeader> {
    let mut header = Header::parse(last.get(HEADER_OFFSET..).unwrap_or(&[]))?;
    header.signed = true;
    put_header(last, &header, Some(&signature));
    Ok(header)
}

fn put_header(last: &mut Page, header: &Header, signature: Option<&[u8; SIGNATURE_LENGTH]>) {
    if let Some(place) = last.last_chunk_mut::<HEADER_LENGTH>() {
        *place = header.to_bytes(signature);
    }
}

/// Length of [`signed_message`].
const MESSAGE_LENGTH: usize = DOMAIN.len() + SIGNED_LENGTH + 64;
/// Keeps a signature from being taken for one over something else.
const DOMAIN: [u8; 16] = *b"windlass image 1";

/// What a signature is made over: a domain text, the header up to its CRC (product, hardware, version,
/// anti-rollback counter, pages, image CRC), and `digest`, the SHA-512 of the same bytes that the image's
/// CRC covers.
#[must_use]
pub fn signed_message(header: &Header, digest: &[u8; 64]) -> [u8; MESSAGE_LENGTH] {
    let bytes = header.to_bytes(None);
    let parts = DOMAIN
        .iter()
        .chain(bytes.iter().take(SIGNED_LENGTH))
        .chain(digest);
    let mut message = [0; MESSAGE_LENGTH];
    for (to, from) in message.iter_mut().zip(parts) {
        *to = *from;
    }
    message
}
