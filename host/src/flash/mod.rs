//! Updating the firmware of a device over CAN.
//!
//! [`flash`] goes through the phases enter, erase, write, verify, restart and confirm, and ends well only
//! once the new version has been read from the running application. Whatever interrupts it (a lost link, a
//! device without power, Ctrl-C) leaves a bootloader that can be flashed again: what it has stored is asked
//! for, and only the pages that are missing are sent.

mod error;
mod session;
mod transfer;

use std::time::Duration;

use crate::client::{Address, Client, Device, Version};
use crate::image::Image;
use crate::transport::Bus;

pub use error::FlashError;
use session::Session;

/// What an update does at the moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// Restarting the device into its bootloader.
    Enter,
    /// Sending the first page, which erases the old image.
    Erase,
    /// Sending the other pages.
    Write,
    /// Asking the device what it has stored.
    Verify,
    /// Putting the fallback image back.
    Restore,
    /// Restarting the device.
    Restart,
    /// Reading the version from the running application.
    Confirm,
}

impl Phase {
    /// The phase as a word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Enter => "enter",
            Self::Erase => "erase",
            Self::Write => "write",
            Self::Verify => "verify",
            Self::Restore => "restore",
            Self::Restart => "restart",
            Self::Confirm => "confirm",
        }
    }
}

/// Whoever watches an update.
pub trait Observer {
    /// A phase begins.
    fn phase(&mut self, phase: Phase);

    /// So many of the image's pages are stored, at `now` on the bus's clock.
    fn pages(&mut self, stored: usize, of: usize, now: Duration);

    /// The device does not answer any more; it is being looked for.
    fn lost(&mut self, reason: &str);

    /// The device is back.
    fn found(&mut self, address: Address);

    /// True once the update is to end as soon as possible.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// An observer that looks away.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn phase(&mut self, _phase: Phase) {}
    fn pages(&mut self, _stored: usize, _of: usize, _now: Duration) {}
    fn lost(&mut self, _reason: &str) {}
    fn found(&mut self, _address: Address) {}
}

/// How to update.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Send every page even if the device has it, and go on with a device that does not tell its hardware:
    /// it checks that by itself. Nothing that protects the device or the motor is switched off by this.
    pub force: bool,
    /// How long to look for a device that has stopped answering.
    pub patience: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            force: false,
            patience: Duration::from_secs(30),
        }
    }
}

/// How an update went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Where the device is reached now.
    pub address: Address,
    /// Version of the application that ran before, if one did.
    pub before: Option<Version>,
    /// Version of the application that runs now.
    pub version: Version,
    /// Pages that were sent and acknowledged.
    pub sent: usize,
    /// Pages of the image.
    pub pages: usize,
    /// The device has marked the image as confirmed; `None` if it does not tell.
    pub confirmed: Option<bool>,
    /// Time on the bus.
    pub took: Duration,
}

/// Whether the image is for this device, as far as the device tells before it is restarted.
///
/// # Errors
/// It is not, or the device drives its motor or does not answer.
pub fn check<B: Bus>(
    client: &mut Client<B>,
    device: &Device,
    image: &Image,
    options: &Options,
) -> Result<(), FlashError> {
    Session::new(client, device, *options, &mut Unobserved).check_first(image)
}

/// Updates one device.
///
/// # Errors
/// The image is not for this device, the device refused, or it was lost and did not come back; see
/// [`FlashError`].
pub fn flash<B: Bus>(
    client: &mut Client<B>,
    device: &Device,
    image: &Image,
    options: &Options,
    observer: &mut dyn Observer,
) -> Result<Report, FlashError> {
    Session::new(client, device, *options, observer).update(image)
}

/// Puts the image back that one device has in its fallback slot.
///
/// # Errors
/// The device has no such image, refused, or was lost and did not come back; see [`FlashError`].
pub fn roll_back<B: Bus>(
    client: &mut Client<B>,
    device: &Device,
    options: &Options,
    observer: &mut dyn Observer,
) -> Result<Report, FlashError> {
    Session::new(client, device, *options, observer).roll_back()
}

/// Installs a public key: from then on the device accepts only images that are signed with it. `order` is the
/// key; where another key is installed, followed by that one's signature of the new one.
///
/// # Errors
/// The device refused, knows no signatures, or was lost; see [`FlashError`].
pub fn install_key<B: Bus>(
    client: &mut Client<B>,
    device: &Device,
    order: &[u8],
    observer: &mut dyn Observer,
) -> Result<(), FlashError> {
    Session::new(client, device, Options::default(), observer).install_key(order)
}
