//! Firmware files: read, checked, sealed, signed and written.
//!
//! [`load`] and [`parse`] read ELF, Intel HEX, bare binaries and the containers `.wlimg` and `.crf` into
//! pages. An [`Image`] is what may be sent to a device: pages with a header whose CRC covers all of them.

mod bytes;
pub mod container;
pub mod crf;
pub mod elf;
mod error;
mod file;
pub mod hex;
pub mod key;
pub mod memory;
mod pages;

use ed25519_dalek::{SigningKey, VerifyingKey};
use sha2::{Digest, Sha512};
use windlass_core::boot::image::{
    HEADER_OFFSET, Hardware, Header, LAST_PAGE, PAGE_SIZE, Page, pack, pages_of, put_signature,
    signed_message, verify,
};

pub use error::FileError;
pub use file::{Contents, Format, load, parse};
pub use pages::Pages;

use memory::Memory;

/// An image that may be sent: its pages, with a header that covers all of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    pages: Pages,
    header: Header,
}

impl Image {
    /// The image of a sealed file.
    ///
    /// # Errors
    /// The file has no seal.
    pub fn sealed(contents: Contents) -> Result<Self, FileError> {
        if !contents.is_sealed() {
            return Err(FileError::NotSealed);
        }
        let header = file::check_seal(&contents)?;
        let pages = contents.pages;
        Ok(Self { pages, header })
    }

    /// The image of any file: one without a seal is given its header.
    ///
    /// # Errors
    /// What stands in the file cannot be packed.
    pub fn packed(mut contents: Contents) -> Result<Self, FileError> {
        if contents.is_sealed() {
            return Self::sealed(contents);
        }
        let blank: Page = [0xFF; PAGE_SIZE];
        let mut last = *contents.pages.get(LAST_PAGE).unwrap_or(&blank);
        pack(|page| contents.pages.get(page), &mut last)?;
        let put = contents.pages.put(LAST_PAGE, 0, &last);
        debug_assert!(put, "page 30 takes a page");
        Self::sealed(contents)
    }

    /// The header.
    #[must_use]
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The pages.
    #[must_use]
    pub const fn pages(&self) -> &Pages {
        &self.pages
    }

    /// Name of the hardware that the image is for.
    #[must_use]
    pub fn hardware_name(&self) -> &'static str {
        Hardware::from_id(self.header.identity.hardware).map_or("unknown", |row| row.name)
    }

    /// The bytes that a signature is made over.
    fn message(&self) -> Vec<u8> {
        let mut digest = Sha512::new();
        // The pages are those that the header was checked against when the image was made.
        let checked = verify(&mut &self.pages, |bytes| digest.update(bytes));
        debug_assert!(checked.is_ok(), "an image has a valid header");
        signed_message(&self.header, &digest.finalize().into()).to_vec()
    }

    /// The same image with a signature.
    #[must_use]
    pub fn signed(mut self, key: &SigningKey) -> Self {
        let signature = key::sign(key, &self.message());
        let blank: Page = [0xFF; PAGE_SIZE];
        let mut last = *self.pages.get(LAST_PAGE).unwrap_or(&blank);
        if let Ok(header) = put_signature(&mut last, signature) {
            let put = self.pages.put(LAST_PAGE, 0, &last);
            debug_assert!(put, "page 30 takes a page");
            self.header = header;
        }
        self
    }

    /// Whether the image has a signature that this key made; none if it has no signature.
    #[must_use]
    pub fn verify_signature(&self, key: &VerifyingKey) -> Option<bool> {
        let last = self.pages.get(LAST_PAGE)?;
        let signature = Header::signature(last.last_chunk()?);
        let signed = self.header.signed;
        signed.then(|| key::verify(key, &self.message(), &signature))
    }

    /// A linker's ELF file with the image's header in a segment of its own, if `file` is one whose page 0
    /// stands at `base`. Programmers and debuggers go on reading it.
    ///
    /// # Errors
    /// The file is no ELF file, or has a header already.
    pub fn seal_elf(&self, file: &[u8], base: u32) -> Result<Vec<u8>, FileError> {
        let hardware = Hardware::from_id(self.header.identity.hardware);
        let room = hardware.map_or(0, |row| row.pages);
        // Page 30 follows the last page that the slot has room for.
        let before = room.count_ones().saturating_sub(1);
        let offset = before * PAGE_SIZE as u32 + HEADER_OFFSET as u32;
        let last = self.pages.get(LAST_PAGE).ok_or(FileError::NotSealed)?;
        Ok(elf::with_segment(
            file,
            base.saturating_add(offset),
            &last[HEADER_OFFSET..],
        )?)
    }

    /// The image as a file. A HEX file has page N at address 0x1000 × N, as the guide says; a binary has
    /// the slot's bytes from the first to the header. None for ELF, see [`Image::seal_elf`].
    #[must_use]
    pub fn write(&self, format: Format) -> Option<Vec<u8>> {
        match format {
            Format::Elf => None,
            Format::Container => {
                let label = container::Label::of(&self.header);
                Some(container::write(label, &self.pages))
            }
            Format::Crf => Some(crf::write(crf::Label::of(&self.header), &self.pages)),
            Format::Hex => {
                let mut memory = Memory::default();
                for (number, contents) in self.pages.iter() {
                    // 31 pages are far fewer than memory takes.
                    let _ = memory.add(u32::from(number) * PAGE_SIZE as u32, contents);
                }
                Some(hex::write(&memory).into_bytes())
            }
            Format::Bin => {
                let mut bytes = Vec::new();
                let hardware = Hardware::from_id(self.header.identity.hardware)?;
                for number in pages_of(hardware.pages) {
                    match self.pages.get(number) {
                        Some(contents) => bytes.extend(contents),
                        None => bytes.extend([0xFF; PAGE_SIZE]),
                    }
                }
                Some(bytes)
            }
        }
    }
}
