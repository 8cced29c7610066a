//! The page protocol of an update: what `vcmdEraseWriteFlashPage` and the commands beside it do to the
//! slots.
//!
//! Sources: DMC60C guide, `vcmdEraseWriteFlashPage` and "Firmware Updates"; docs/dmc60c.md. What differs
//! from the guide's device is where an image becomes valid: not by a version word that is written last, but
//! by a commit record behind a check of the whole image (docs/updates.md).
//!
//! A page is held in RAM until its CRC is known: flash is never touched for a damaged transfer, on no chip
//! and in no state of the update. That costs 4 KiB of the bootloader's 6 KiB; programming while a page
//! arrives would need erased flash in advance, could not take back a damaged page on a chip with one erase
//! unit per slot, and would gain 16 ms of 85 per page.

use core::borrow::BorrowMut;

use embedded_storage::nor_flash::NorFlash;

use super::image::{
    FIRST_PAGE, HEADER_OFFSET, Header, LAST_PAGE, NO_VERSION, PAGE_COUNT, PAGE_SIZE, Page,
};
use super::slots::{Log, Record, Refresh, SlotError, Slots, View};
use super::status::{BootStatus, Reason, STATUS_LENGTH};
use super::trust::{Trust, is_trusted};
use crate::crc;
use crate::management::vendor::CommandCode;

/// Bytes that follow the command: the page and its CRC.
pub const TRANSFER_SIZE: usize = PAGE_SIZE + 4;

/// Image type of an application (guide, `vcmdEraseWriteFlashPage`, `PARAM1`).
const APPLICATION: u16 = 0;

/// Attempts to erase and write a page (docs/dmc60c.md: five retries).
const ATTEMPTS: u8 = 6;

/// The two CRC variants of a page differ by this: CRC-32/ISO-HDLC of a page of zeros, whose page transfer
/// CRC is 0. Both are linear in the data.
const VARIANTS: u32 = variants();

const fn variants() -> u32 {
    let mut crc = crc::Crc32::new();
    let mut at = 0;
    while at < PAGE_SIZE {
        crc.push(0);
        at += 1;
    }
    crc.finish()
}

/// The updater with its page buffer: the page itself, or a reference to one where it must not be copied on its way
/// to its place.
#[derive(Clone, Debug)]
pub struct Updater<P = Page> {
    page: P,
    crc: [u8; 4],
    view: View,
    /// Pages of the image whose header is stored; 0 without one.
    wanted: u32,
    version: u16,
}

impl Updater {
    /// Checks a command before its data come.
    ///
    /// # Errors
    /// `BadParameter`: the image type is not the application's, or there is no such page (guide). Neither
    /// the bootloader nor an auxiliary bootloader can be written by the bootloader that runs.
    pub const fn expect(image: u16, page: u16) -> Result<u8, CommandCode> {
        if image != APPLICATION || page >= PAGE_COUNT as u16 {
            return Err(CommandCode::BadParameter);
        }
        Ok(page as u8)
    }
}

impl<P: BorrowMut<Page>> Updater<P> {
    /// An updater that has not looked at the slots yet.
    #[must_use]
    pub const fn new(page: P) -> Self {
        Self {
            page,
            crc: [0; 4],
            view: View::NOTHING,
            wanted: 0,
            version: NO_VERSION,
        }
    }

    /// Looks at what is in the slots.
    #[inline(never)]
    pub fn look<A: NorFlash, F: NorFlash>(&mut self, slots: &mut Slots<A, F>) {
        slots.look(&mut self.view);
        let header = slots.application.header();
        let stored = self.view.application.stored & 1 << LAST_PAGE != 0;
        let valid = self.view.is_committed() && self.view.whole;
        self.wanted = header.filter(|_| stored).map_or(0, |header| header.pages);
        self.version = header
            .filter(|_| valid)
            .map_or(NO_VERSION, |header| header.identity.version);
    }

    /// Version of the valid image in the application slot; [`NO_VERSION`] if there is none.
    #[must_use]
    pub const fn version(&self) -> u16 {
        self.version
    }

    /// Takes data of a transfer; what is beyond its end is dropped.
    pub fn take(&mut self, offset: usize, bytes: &[u8]) {
        let page = self.page.borrow_mut();
        for (at, byte) in (offset..).zip(bytes) {
            let place = match at.checked_sub(PAGE_SIZE) {
                None => page.get_mut(at),
                Some(at) => self.crc.get_mut(at),
            };
            if let Some(place) = place {
                *place = *byte;
            }
        }
    }

    /// The data that were taken.
    #[must_use]
    pub fn data(&self) -> &Page {
        self.page.borrow()
    }

    /// A page has arrived whole: checks it, stores it, and commits the image if it was the last one
    /// missing.
    #[inline(never)]
    pub fn write<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        trust: &Trust,
        page: u8,
    ) -> CommandCode {
        match self.try_write(slots, trust, page) {
            Ok(()) => CommandCode::NoError,
            Err(code) => code,
        }
    }

    fn try_write<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        trust: &Trust,
        page: u8,
    ) -> Result<(), CommandCode> {
        let received = u32::from_le_bytes(self.crc);
        let crc = crc::page_transfer(self.page.borrow());
        if received != crc && received != crc ^ VARIANTS {
            return Err(CommandCode::CrcMismatch);
        }
        if page == LAST_PAGE {
            self.begin(slots, trust)?;
            self.record(slots, page, crc)
        } else {
            self.store(slots, page, crc)
        }?;
        self.commit(slots, trust, page)
    }

    /// Page 30: checks what is coming, then voids what is there.
    fn begin<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        trust: &Trust,
    ) -> Result<(), CommandCode> {
        let header = self.data().get(HEADER_OFFSET..).unwrap_or(&[]);
        let header = Header::parse(header).map_err(|_| CommandCode::NoImage)?;
        trust.admits(&header, slots.application.room())?;
        self.void(slots);
        let mut result = Err(CommandCode::FlashWriteFailed);
        for _ in 0..ATTEMPTS {
            self.view.application = Log::EMPTY;
            self.view.whole = false;
            self.wanted = 0;
            self.version = NO_VERSION;
            if slots.application.erase_trailer().is_ok() && self.program(slots, LAST_PAGE).is_ok() {
                self.wanted = header.pages;
                result = Ok(());
                break;
            }
        }
        result
    }

    /// Writes to the other slot that the image in this one is no longer valid, if it still is.
    fn void<A: NorFlash, F: NorFlash>(&mut self, slots: &mut Slots<A, F>) {
        let generation = self.view.next_generation();
        let is_due = self.view.is_committed() || self.view.is_restoring();
        let is_sound = self.view.application.refresh != Refresh::Begun;
        if let (Some(slot), Some(log)) = (&mut slots.fallback, &mut self.view.fallback)
            && is_due
            && is_sound
        {
            // If there is no place left, the erase that follows voids the image all the same; what is lost
            // is the protection against an erase that is interrupted and leaves everything readable.
            let _ = slot.append_twice(log, Record::UpdateBegun { generation });
        }
    }

    /// Any other page.
    fn store<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        page: u8,
        crc: u32,
    ) -> Result<(), CommandCode> {
        if self.wanted.checked_shr(u32::from(page)).unwrap_or(0) & 1 == 0 {
            return Err(CommandCode::PageOrder);
        }
        if self.view.application.stored & 1 << page != 0 {
            // A repetition, because its status was lost.
            return if slots.application.page_is(page, self.page.borrow()) {
                Ok(())
            } else {
                Err(CommandCode::PageOrder)
            };
        }
        if slots.application.erased_whole() {
            // Something was begun here before the power failed; only page 30 can erase it.
            if !slots.application.page_is_blank(page) {
                return Err(CommandCode::PageOrder);
            }
            self.program(slots, page)?;
        } else {
            let written = (0..ATTEMPTS).any(|_| self.program(slots, page).is_ok());
            if !written {
                return Err(CommandCode::FlashWriteFailed);
            }
        }
        self.record(slots, page, crc)
    }

    /// Erases (where a page can be), programs and verifies.
    fn program<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        page: u8,
    ) -> Result<(), CommandCode> {
        let slot = &mut slots.application;
        let programmed = slot.erase_page(page).is_ok()
            && slot.program(page, 0, self.page.borrow()).is_ok()
            && slot.page_is(page, self.page.borrow());
        if programmed {
            Ok(())
        } else {
            Err(CommandCode::FlashWriteFailed)
        }
    }

    fn record<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        page: u8,
        crc: u32,
    ) -> Result<(), CommandCode> {
        let log = &mut self.view.application;
        if log.stored & 1 << page != 0 {
            return Ok(());
        }
        match slots.application.append(log, Record::Stored { page, crc }) {
            Ok(()) => Ok(()),
            // So many interruptions that the trailer is full.
            Err(SlotError::Full) => Err(CommandCode::PageOrder),
            Err(_) => Err(CommandCode::FlashWriteFailed),
        }
    }

    /// Commits the image once nothing is missing.
    fn commit<A: NorFlash, F: NorFlash>(
        &mut self,
        slots: &mut Slots<A, F>,
        trust: &Trust,
        page: u8,
    ) -> Result<(), CommandCode> {
        if self.view.is_committed() {
            return Ok(());
        }
        if self.wanted & !self.view.application.stored != 0 {
            return if page == FIRST_PAGE {
                Err(CommandCode::ImageIncomplete)
            } else {
                Ok(())
            };
        }
        let slot = &mut slots.application;
        let header = slot.check().map_err(|_| CommandCode::ImageCrc)?;
        if !is_trusted(slot, &header, trust) {
            return Err(CommandCode::BadSignature);
        }
        let record = Record::Committed {
            generation: self.view.next_generation(),
            image_crc: header.image_crc,
        };
        slot.append_twice(&mut self.view.application, record)
            .map_err(|_| CommandCode::FlashWriteFailed)?;
        self.view.whole = true;
        self.version = header.identity.version;
        Ok(())
    }

    /// Puts the fallback image back (`vcmdRestoreFallback`).
    pub fn restore<A: NorFlash, F: NorFlash>(&mut self, slots: &mut Slots<A, F>) -> CommandCode {
        let restored = slots.restore(&mut self.view);
        self.look(slots);
        match restored {
            Ok(()) => CommandCode::NoError,
            Err(SlotError::NoRoom | SlotError::Mismatch) => CommandCode::NoFallback,
            Err(SlotError::Flash | SlotError::Full) => CommandCode::FlashWriteFailed,
        }
    }

    /// The answer to `vcmdGetBootStatus`.
    pub fn status<A: NorFlash, F: NorFlash>(
        &self,
        slots: &mut Slots<A, F>,
        trust: &Trust,
        reason: Reason,
    ) -> [u8; STATUS_LENGTH] {
        let log = &self.view.application;
        let valid = self.version != NO_VERSION;
        let fallback = slots
            .fallback
            .as_mut()
            .filter(|_| self.view.has_fallback())
            .and_then(|slot| slot.header());
        BootStatus {
            reason,
            confirmed: valid && log.confirmed(),
            key_installed: trust.key.is_some(),
            has_fallback: self.view.fallback.is_some(),
            trial_failures: log.trial_failures,
            application: self.version,
            fallback: fallback.map_or(NO_VERSION, |header| header.identity.version),
            rollback: trust.rollback,
            stored: log.stored,
            wanted: self.wanted,
            product: trust.product,
            hardware: trust.hardware,
            room: slots.application.room(),
        }
        .to_bytes()
    }
}
