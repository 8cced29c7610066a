//! The page protocol of firmware updates (guide, "Firmware Updates").

use std::time::Duration;

use windlass_core::management::vendor::Command;

use super::vendor::Exchange;
use super::{Address, Client};
use crate::transport::{Bus, BusError};

/// Image type of an application in `vcmdEraseWriteFlashPage`.
const IMAGE_APPLICATION: u16 = 0;

impl<B: Bus> Client<B> {
    /// Sends one page to the bootloader, which checks its CRC, erases and programs it: one attempt. Gives
    /// the device's result code, or nothing if it did not answer within `patience`.
    ///
    /// # Errors
    /// The bus failed.
    pub fn write_page(
        &mut self,
        address: Address,
        page: u8,
        contents: &[u8; 4096],
        patience: Duration,
    ) -> Result<Option<u16>, BusError> {
        let mut payload = contents.to_vec();
        payload.extend(windlass_core::crc::page_transfer(contents).to_le_bytes());
        let exchange = Exchange {
            param1: IMAGE_APPLICATION,
            param2: u16::from(page),
            payload: &payload,
            patience,
            ..Exchange::plain(Command::EraseWriteFlashPage, address.number)
        };
        let reply = self.attempt(address, &exchange)?;
        Ok(reply.map(|reply| reply.code))
    }
}
