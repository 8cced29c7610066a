//! The commands of a firmware update: pages (guide, "Firmware Updates") and this project's own about them.

use std::time::Duration;

use windlass_core::boot::image::{PAGE_COUNT, Page};
use windlass_core::boot::status::BootStatus;
use windlass_core::crc;
use windlass_core::management::vendor::{Command, CommandCode};

use super::vendor::{Exchange, Reply, bad_answer, expect};
use super::{Address, Client, Error};
use crate::transport::{Bus, BusError};

/// Image type of an application (guide, `vcmdEraseWriteFlashPage`).
const APPLICATION: u16 = 0;
/// Time for copying the fallback image: 31 pages and the erasing before.
const RESTORE_TIME: Duration = Duration::from_secs(15);
/// Time for writing a key.
const KEY_TIME: Duration = Duration::from_secs(2);

/// What has become of a page that was not answered in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Late {
    /// The device has answered it now, with this code.
    Answered(u16),
    /// The device answers, but has nothing to say about the page: it has not arrived whole, or its answer was lost.
    Unanswered,
    /// The device answers nothing.
    Silent,
}

impl<B: Bus> Client<B> {
    /// Sends one page to the bootloader, which checks its CRC and programs it: one attempt. Gives the
    /// device's result code, or nothing if it did not answer within `patience`.
    ///
    /// # Errors
    /// The bus failed.
    pub fn write_page(
        &mut self,
        address: Address,
        number: u8,
        page: &Page,
        patience: Duration,
    ) -> Result<Option<u16>, BusError> {
        let mut payload = page.to_vec();
        payload.extend(crc::page_transfer(page).to_le_bytes());
        let exchange = Exchange {
            param1: APPLICATION,
            param2: u16::from(number),
            payload: &payload,
            patience,
            ..Exchange::plain(Command::EraseWriteFlashPage, address.number)
        };
        let reply = self.attempt(address, &exchange)?;
        Ok(reply.map(|reply| reply.code))
    }

    /// What a page that was not answered in time has come to. A device does one thing after the other, so that a late
    /// answer comes before that to another question; each is waited for as long as `patience`.
    ///
    /// # Errors
    /// The bus failed.
    pub fn catch_up(&mut self, address: Address, patience: Duration) -> Result<Late, BusError> {
        let exchange = Exchange {
            patience,
            ..Exchange::plain(Command::GetBootStatus, address.number)
        };
        self.post(address, &exchange)?;
        let mut late = Late::Unanswered;
        while let Some(reply) = self.answer(address, &exchange)? {
            let is_of_page =
                reply.data.is_empty() && reply.code != CommandCode::NotSupported as u16;
            if !is_of_page {
                return Ok(late);
            }
            late = Late::Answered(reply.code);
        }
        Ok(Late::Silent)
    }

    /// Reads the CRC of every page, as the page transfer has it; `None` if the device does not know the
    /// command.
    ///
    /// # Errors
    /// No answer, the device refused, or an answer that makes no sense.
    pub fn page_crcs(
        &mut self,
        address: Address,
    ) -> Result<Option<[u32; PAGE_COUNT as usize]>, Error> {
        let command = Command::GetPageCrcs;
        let Some(reply) = self.ask_if_known(address, command)? else {
            return Ok(None);
        };
        let mut crcs = [0; PAGE_COUNT as usize];
        let (words, rest) = reply.data.as_chunks::<4>();
        if words.len() != crcs.len() || !rest.is_empty() {
            return Err(bad_answer(address, command, "not one CRC for each page"));
        }
        for (crc, word) in crcs.iter_mut().zip(words) {
            *crc = u32::from_le_bytes(*word);
        }
        Ok(Some(crcs))
    }

    /// Reads the state of the device's images; `None` if the device does not know the command.
    ///
    /// # Errors
    /// No answer, the device refused, or an answer that makes no sense.
    pub fn boot_status(&mut self, address: Address) -> Result<Option<BootStatus>, Error> {
        let command = Command::GetBootStatus;
        let Some(reply) = self.ask_if_known(address, command)? else {
            return Ok(None);
        };
        BootStatus::from_bytes(&reply.data)
            .map(Some)
            .ok_or_else(|| bad_answer(address, command, "not a status of a known format"))
    }

    /// Lets the bootloader put the fallback image back.
    ///
    /// # Errors
    /// No answer, or the device refused: without a fallback image, for one.
    pub fn restore_fallback(&mut self, address: Address) -> Result<(), Error> {
        let command = Command::RestoreFallback;
        let exchange = Exchange {
            patience: RESTORE_TIME,
            attempts: 1,
            ..Exchange::plain(command, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        expect(address, command, &reply, CommandCode::NoError)
    }

    /// Installs a public key: from then on the device accepts only images that are signed with it. `order`
    /// is the key, and if another key is installed its signature of the new one.
    ///
    /// # Errors
    /// No answer, or the device refused.
    pub fn install_key(&mut self, address: Address, order: &[u8]) -> Result<(), Error> {
        let command = Command::InstallKey;
        let exchange = Exchange {
            param1: order.len() as u16,
            payload: order,
            patience: KEY_TIME,
            ..Exchange::plain(command, address.number)
        };
        let reply = self.transact(address, &exchange)?;
        expect(address, command, &reply, CommandCode::NoError)
    }

    /// A command without parameters that the device may not know.
    fn ask_if_known(&mut self, address: Address, command: Command) -> Result<Option<Reply>, Error> {
        let reply = self.transact(address, &Exchange::plain(command, address.number))?;
        if reply.code == CommandCode::NotSupported as u16 {
            return Ok(None);
        }
        expect(address, command, &reply, CommandCode::NoError)?;
        Ok(Some(reply))
    }
}
