//! Sending the pages of an image, and asking for those that a device has.

use std::time::Duration;

use windlass_core::boot::image::{FIRST_PAGE, LAST_PAGE, Page, pages_of};
use windlass_core::boot::status::BootStatus;
use windlass_core::crc;
use windlass_core::management::vendor::CommandCode;

use super::session::Session;
use super::{FlashError, Phase};
use crate::client::Late;
use crate::image::Image;
use crate::transport::Bus;

/// Time for page 30, which erases the old image: a 128 KiB sector of the STM32F405 takes up to 2 s at full
/// supply and 4 s at the lowest (data sheet, flash memory programming).
const ERASE_TIME: Duration = Duration::from_secs(6);
/// Time for any other page, on the bus and in the flash.
const PAGE_TIME: Duration = Duration::from_secs(2);
/// How many times longer than that a device may take which has been seen to answer late, a busy emulator or a link
/// that buffers.
const SLOWEST: u32 = 8;
/// Attempts at a page before the device counts as lost.
const PAGE_ATTEMPTS: u32 = 5;
/// Times that missing pages are asked for and sent again.
const ROUNDS: u32 = 4;

impl<B: Bus> Session<'_, B> {
    /// Sends pages until the device has committed the image.
    pub(super) fn transfer(&mut self, image: &Image) -> Result<(), FlashError> {
        let mut anew = self.options.force;
        for _ in 0..ROUNDS {
            let status = self.client.boot_status(self.address)?;
            if status.is_none() && !self.options.force {
                return Err(FlashError::UnknownHardware(self.address));
            }
            self.check(image, status.as_ref())?;
            let missing = match (&status, anew) {
                (Some(status), false) => self.missing(image, status)?,
                _ => image.header().pages,
            };
            self.stored = image.pages().len() - missing.count_ones() as usize;
            if missing == 0 && is_committed(image, status.as_ref()) {
                return Ok(());
            }
            anew = match self.send_pages(image, missing)? {
                Sent::All => false,
                Sent::Incomplete => continue,
                Sent::Disordered => true,
            };
            if !anew && self.verify(image)? {
                return Ok(());
            }
        }
        Err(FlashError::NotStored(self.address))
    }

    /// Pages that the device does not have. All of them if it has those of another image.
    fn missing(&mut self, image: &Image, status: &BootStatus) -> Result<u32, FlashError> {
        let all = image.header().pages;
        let Some(crcs) = self.client.page_crcs(self.address)? else {
            return Ok(all);
        };
        if status.wanted != all || status.stored & 1 << LAST_PAGE == 0 {
            return Ok(all);
        }
        let differs = |(number, contents): &(u8, &Page)| {
            crcs.get(usize::from(*number)) != Some(&crc::page_transfer(&contents[..]))
        };
        let stored = |(number, _): &(u8, _)| status.stored & 1 << number != 0;
        if image
            .pages()
            .iter()
            .filter(stored)
            .any(|page| differs(&page))
        {
            return Ok(all);
        }
        Ok(all & !status.stored)
    }

    /// Sends pages: 30 first, then downwards to 0 (guide, "Recommended Application Firmware Update Steps").
    fn send_pages(&mut self, image: &Image, pages: u32) -> Result<Sent, FlashError> {
        // A device that has all pages but no commit takes the first one again and then commits.
        let pages = if pages == 0 { 1 << FIRST_PAGE } else { pages };
        let mut order: Vec<u8> = pages_of(pages).collect();
        order.reverse();
        for number in order {
            if self.observer.is_cancelled() {
                return Err(self.cancelled());
            }
            self.observer.phase(if number == LAST_PAGE {
                Phase::Erase
            } else {
                Phase::Write
            });
            match self.send_page(image, number)? {
                CommandCode::NoError => {}
                CommandCode::ImageIncomplete => return Ok(Sent::Incomplete),
                _ => return Ok(Sent::Disordered),
            }
            self.sent += 1;
            self.stored = (self.stored + 1).min(self.of);
            let now = self.client.now();
            self.observer.pages(self.stored, self.of, now);
        }
        Ok(Sent::All)
    }

    /// Sends one page until it is answered. Gives `NoError`, `ImageIncomplete` or `PageOrder`.
    fn send_page(&mut self, image: &Image, page: u8) -> Result<CommandCode, FlashError> {
        let address = self.address;
        let Some(contents) = image.pages().get(page) else {
            return Err(self.no_answer_to(page));
        };
        let mut refusal = None;
        for attempt in 0..PAGE_ATTEMPTS {
            if attempt > 0 && self.observer.is_cancelled() {
                return Err(self.cancelled());
            }
            let Some(code) = self.try_page(page, contents)? else {
                refusal = None;
                continue;
            };
            match CommandCode::from_code(code as u8) {
                Some(known @ (CommandCode::NoError | CommandCode::ImageIncomplete)) => {
                    return Ok(known);
                }
                Some(CommandCode::PageOrder) if page != LAST_PAGE => {
                    return Ok(CommandCode::PageOrder);
                }
                // The transfer was disturbed, or the flash needs another attempt.
                Some(
                    CommandCode::CrcMismatch
                    | CommandCode::DataReceivedMore
                    | CommandCode::FlashWriteFailed,
                ) => refusal = Some(code),
                // Another host's status, or a late one of an earlier attempt.
                Some(CommandCode::InBootloader | CommandCode::AcknowledgeReset) => {}
                _ => {
                    return Err(FlashError::PageRefused {
                        address,
                        page,
                        code,
                    });
                }
            }
        }
        match refusal {
            Some(code) => Err(FlashError::PageRefused {
                address,
                page,
                code,
            }),
            None => Err(self.no_answer_to(page)),
        }
    }

    /// Sends a page once. Gives the device's code, also if it comes late; nothing if the page or its answer was lost.
    fn try_page(&mut self, page: u8, contents: &Page) -> Result<Option<u16>, FlashError> {
        let usual = if page == LAST_PAGE {
            ERASE_TIME
        } else {
            PAGE_TIME
        };
        let (address, patience) = (self.address, usual * self.slowness);
        let code = self.client.write_page(address, page, contents, patience)?;
        if code.is_some() {
            return Ok(code);
        }
        let late = self.client.catch_up(address, patience)?;
        if late != Late::Unanswered {
            self.slowness = (self.slowness * 2).min(SLOWEST);
        }
        match late {
            Late::Answered(code) => Ok(Some(code)),
            Late::Unanswered => Ok(None),
            Late::Silent => Err(self.no_answer_to(page)),
        }
    }

    fn no_answer_to(&self, page: u8) -> FlashError {
        self.silence(format!("vcmdEraseWriteFlashPage of page {page}"))
            .into()
    }

    /// Whether the device has committed exactly this image. A device that does not tell is believed: its
    /// acknowledgements are all there is.
    fn verify(&mut self, image: &Image) -> Result<bool, FlashError> {
        self.observer.phase(Phase::Verify);
        let Some(status) = self.client.boot_status(self.address)? else {
            return Ok(true);
        };
        Ok(is_committed(image, Some(&status)) && self.missing(image, &status)? == 0)
    }
}

/// What became of a round of pages.
enum Sent {
    /// All were acknowledged.
    All,
    /// Some that were sent earlier are missing.
    Incomplete,
    /// The device wants to begin again with page 30.
    Disordered,
}

fn is_committed(image: &Image, status: Option<&BootStatus>) -> bool {
    let version = image.header().identity.version;
    status.is_some_and(|status| status.application == version)
}
