//! One update of one device.

use std::time::Duration;

use windlass_core::boot::image::{FIRST_PAGE, Hardware, LAST_PAGE, NO_VERSION, pages_of};
use windlass_core::boot::status::BootStatus;
use windlass_core::crc;
use windlass_core::management::vendor::{CommandCode, Descriptor};
use windlass_core::management::wire::ImageType;

use super::{FlashError, Observer, Options, Phase, Report};
use crate::client::{self, Address, Client, Device, Version};
use crate::image::Image;
use crate::transport::Bus;

/// Time for page 30, which erases the old image: a 128 KiB sector of the STM32F405 takes up to 2 s at full
/// supply and 4 s at the lowest (data sheet, flash memory programming).
const ERASE_TIME: Duration = Duration::from_secs(6);
/// Time for any other page, on the bus and in the flash.
const PAGE_TIME: Duration = Duration::from_secs(2);
/// Attempts at a page before the device counts as lost.
const PAGE_ATTEMPTS: u32 = 5;
/// Times that a device is told to restart.
const RESTARTS: u32 = 3;
/// Times that missing pages are asked for and sent again.
const ROUNDS: u32 = 4;
/// Time in which a driven device is sure to have said so: several periods of its status frame.
const DRIVE_CHECK: Duration = Duration::from_millis(120);
/// What a device without a serial number reports.
const NO_SERIAL: &str = "UNKNOWN";

pub(super) struct Session<'a, B: Bus> {
    client: &'a mut Client<B>,
    observer: &'a mut dyn Observer,
    options: Options,
    address: Address,
    product: Option<u32>,
    serial: Option<String>,
    before: Option<Version>,
    /// The device has everything and has committed it.
    committed: bool,
    /// Pages of the image that the device is known to have.
    stored: usize,
    sent: usize,
    started: Duration,
}

impl<'a, B: Bus> Session<'a, B> {
    pub(super) fn new(
        client: &'a mut Client<B>,
        device: &Device,
        options: Options,
        observer: &'a mut dyn Observer,
    ) -> Self {
        let started = client.now();
        Self {
            client,
            observer,
            options,
            address: device.address,
            product: device.product_id,
            serial: None,
            before: None,
            committed: false,
            stored: 0,
            sent: 0,
            started,
        }
    }

    pub(super) fn check_first(mut self, image: &Image) -> Result<(), FlashError> {
        let status = self.look()?;
        self.check(image, status.as_ref())
    }

    pub(super) fn update(mut self, image: &Image) -> Result<Report, FlashError> {
        let status = self.look()?;
        self.check(image, status.as_ref())?;
        self.again(|session| session.update_once(image))?;
        let version = Version(image.header().identity.version);
        self.report(version, image.pages().len())
    }

    pub(super) fn roll_back(mut self) -> Result<Report, FlashError> {
        let status = self.look()?;
        let fallback = status.map_or(NO_VERSION, |status| status.fallback);
        if status.is_some() && fallback == NO_VERSION {
            return Err(FlashError::NoFallback(self.address));
        }
        let mut version = fallback;
        self.again(|session| session.roll_back_once(&mut version))?;
        self.report(Version(version), 0)
    }

    fn report(self, version: Version, pages: usize) -> Result<Report, FlashError> {
        // The answer to the version made the application confirm itself; it may need a moment to write.
        let confirmed = match self.client.boot_status(self.address) {
            Ok(status) => status.map(|status| status.confirmed),
            Err(client::Error::Bus(error)) => return Err(error.into()),
            Err(_) => None,
        };
        Ok(Report {
            address: self.address,
            before: self.before,
            version,
            sent: self.sent,
            pages,
            confirmed,
            took: self.client.now().saturating_sub(self.started),
        })
    }

    /// Reads what there is before anything is changed.
    fn look(&mut self) -> Result<Option<BootStatus>, FlashError> {
        let versions = self.client.firmware_versions(self.address)?;
        if versions.application != NO_VERSION {
            self.before = Some(Version(versions.application));
        }
        let strings = self.client.descriptors(self.address)?;
        let serial = strings.text(Descriptor::SerialNumber);
        self.serial = (serial != NO_SERIAL && !serial.is_empty()).then(|| serial.to_owned());
        if self.product.is_none() {
            let devices = self.client.enumerate()?;
            let found = devices.iter().find(|device| device.address == self.address);
            self.product = found.and_then(|device| device.product_id);
        }
        if versions.image == ImageType::Application {
            self.client.listen(DRIVE_CHECK)?;
            let now = self.client.now();
            let status = self.client.status(self.address.number);
            let general = status.and_then(|status| status.general.as_ref());
            if general.is_some_and(|live| !live.is_stale(now) && live.value.duty != 0) {
                return Err(FlashError::Driving(self.address));
            }
        }
        Ok(self.client.boot_status(self.address)?)
    }

    /// Refuses an image that this device would refuse.
    fn check(&self, image: &Image, status: Option<&BootStatus>) -> Result<(), FlashError> {
        let identity = &image.header().identity;
        let address = self.address;
        let product = status.map(|status| status.product).or(self.product);
        if let Some(device) = product
            && device != identity.product
        {
            let image = identity.product;
            return Err(FlashError::WrongProduct {
                address,
                image,
                device,
            });
        }
        let Some(status) = status else {
            return Ok(());
        };
        if status.hardware != identity.hardware || image.header().pages & !status.room != 0 {
            return Err(FlashError::WrongHardware {
                address,
                image: hardware_name(identity.hardware),
                device: hardware_name(status.hardware),
            });
        }
        if identity.rollback < status.rollback {
            return Err(FlashError::RollbackRefused {
                address,
                image: identity.rollback,
                device: status.rollback,
            });
        }
        if status.key_installed && image.header().signature.is_none() {
            return Err(FlashError::Unsigned(address));
        }
        Ok(())
    }

    /// Does `work`, and if the device stops answering looks for it and does it again: every step looks
    /// first at what is done already.
    fn again(
        &mut self,
        mut work: impl FnMut(&mut Self) -> Result<(), FlashError>,
    ) -> Result<(), FlashError> {
        let mut progress = (self.sent, self.committed);
        let mut fruitless = 0;
        loop {
            let error = match work(self) {
                Err(error) if error.is_silence() => error,
                other => return other,
            };
            let now = (self.sent, self.committed);
            fruitless = if now == progress { fruitless + 1 } else { 0 };
            progress = now;
            let cause = error.to_string();
            if fruitless > 2 {
                let address = self.address;
                return Err(FlashError::Lost { address, cause });
            }
            self.observer.lost(&cause);
            self.find_again(&cause)?;
            self.observer.found(self.address);
        }
    }

    /// Looks for the device until it answers: by its session, else by its number and serial number.
    fn find_again(&mut self, cause: &str) -> Result<(), FlashError> {
        let deadline = self.client.now() + self.options.patience;
        loop {
            if self.observer.is_cancelled() {
                return Err(self.lost(cause));
            }
            let devices = self.client.enumerate()?;
            let same = devices.iter().find(|device| device.address == self.address);
            if same.is_some() {
                return Ok(());
            }
            let numbered: Vec<Address> = devices
                .iter()
                .map(|device| device.address)
                .filter(|address| address.number == self.address.number)
                .collect();
            if let Some(address) = self.recognise(&numbered)? {
                self.address = address;
                return Ok(());
            }
            if self.client.now() >= deadline {
                return Err(self.lost(cause));
            }
        }
    }

    fn lost(&self, cause: &str) -> FlashError {
        FlashError::Lost {
            address: self.address,
            cause: cause.to_owned(),
        }
    }

    /// The device among those with its number: the one with its serial number, or the only one if it has
    /// none.
    fn recognise(&mut self, candidates: &[Address]) -> Result<Option<Address>, FlashError> {
        let Some(serial) = self.serial.clone() else {
            return Ok(match candidates {
                [only] => Some(*only),
                _ => None,
            });
        };
        for candidate in candidates {
            match self.client.descriptors(*candidate) {
                Ok(strings) if strings.text(Descriptor::SerialNumber) == serial => {
                    return Ok(Some(*candidate));
                }
                Err(client::Error::Bus(error)) => return Err(error.into()),
                Ok(_) | Err(_) => {}
            }
        }
        Ok(None)
    }

    fn update_once(&mut self, image: &Image) -> Result<(), FlashError> {
        if !self.committed {
            self.enter()?;
            self.transfer(image)?;
            self.committed = true;
        }
        self.start(Version(image.header().identity.version))
    }

    fn roll_back_once(&mut self, version: &mut u16) -> Result<(), FlashError> {
        if !self.committed {
            self.enter()?;
            let status = self.client.boot_status(self.address)?;
            let status = status.ok_or(FlashError::UnknownHardware(self.address))?;
            // An answer that was lost: the image has been put back already.
            let restored = *version != NO_VERSION && status.application == *version;
            if !restored {
                if status.fallback == NO_VERSION {
                    return Err(FlashError::NoFallback(self.address));
                }
                *version = status.fallback;
                self.observer.phase(Phase::Restore);
                self.client.restore_fallback(self.address)?;
            }
            self.committed = true;
        }
        self.start(Version(*version))
    }

    /// Restarts the device into its bootloader unless that runs.
    fn enter(&mut self) -> Result<(), FlashError> {
        if self.observer.is_cancelled() {
            return Err(FlashError::CancelledEarly(self.address));
        }
        for _ in 0..RESTARTS {
            if self.image()? != ImageType::Application {
                return Ok(());
            }
            self.observer.phase(Phase::Enter);
            let restarted = self.client.enter_bootloader(self.address);
            unless_refused(restarted)?;
        }
        match self.image()? {
            ImageType::Application => Err(self.silence("vcmdEnterBootloader").into()),
            _ => Ok(()),
        }
    }

    fn image(&mut self) -> Result<ImageType, FlashError> {
        Ok(self.client.firmware_versions(self.address)?.image)
    }

    fn silence(&self, request: impl Into<String>) -> client::Error {
        client::Error::NoAnswer {
            address: self.address,
            request: request.into(),
        }
    }

    /// Sends pages until the device has committed the image.
    fn transfer(&mut self, image: &Image) -> Result<(), FlashError> {
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
        let differs = |(number, contents): &(u8, &windlass_core::boot::image::Page)| {
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
        let of = image.pages().len();
        let mut order: Vec<u8> = pages_of(pages).collect();
        order.reverse();
        for number in order {
            if self.observer.is_cancelled() {
                let (address, stored) = (self.address, self.stored);
                return Err(FlashError::Cancelled {
                    address,
                    stored,
                    of,
                });
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
            self.stored = (self.stored + 1).min(of);
            let now = self.client.now();
            self.observer.pages(self.stored, of, now);
        }
        Ok(Sent::All)
    }

    /// Sends one page until it is answered. Gives `NoError`, `ImageIncomplete` or `PageOrder`.
    fn send_page(&mut self, image: &Image, page: u8) -> Result<CommandCode, FlashError> {
        let address = self.address;
        let silence = self.silence(format!("vcmdEraseWriteFlashPage of page {page}"));
        let Some(contents) = image.pages().get(page) else {
            return Err(silence.into());
        };
        let patience = if page == LAST_PAGE {
            ERASE_TIME
        } else {
            PAGE_TIME
        };
        let mut refusal = None;
        for _ in 0..PAGE_ATTEMPTS {
            let code = self.client.write_page(address, page, contents, patience)?;
            let Some(code) = code else {
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
            None => Err(silence.into()),
        }
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

    /// Restarts the device and waits until the version is read from its application.
    fn start(&mut self, wanted: Version) -> Result<(), FlashError> {
        let address = self.address;
        for _ in 0..RESTARTS {
            if self.image()? == ImageType::Application {
                break;
            }
            self.observer.phase(Phase::Restart);
            let restarted = self.client.soft_reset(address);
            unless_refused(restarted)?;
        }
        self.observer.phase(Phase::Confirm);
        let versions = self.client.firmware_versions(address)?;
        if versions.image != ImageType::Application {
            let status = self.client.boot_status(address)?;
            let reason = status.map(|status| status.reason);
            return Err(FlashError::NotStarted { address, reason });
        }
        let found = Version(versions.application);
        if found == wanted {
            return Ok(());
        }
        Err(FlashError::WrongVersion {
            address,
            found,
            wanted,
        })
    }
}

/// The result of a restart, except that silence and statuses of something else are no errors: the
/// acknowledgement may be lost, or the late answer to a page may come first. What runs is asked for anyway.
fn unless_refused(result: Result<(), client::Error>) -> Result<(), client::Error> {
    match result {
        Err(client::Error::NoAnswer { .. }) => Ok(()),
        Err(client::Error::Refused { code, .. }) if code != CommandCode::NotSupported.name() => {
            Ok(())
        }
        other => other,
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

fn hardware_name(id: u32) -> String {
    Hardware::from_id(id).map_or_else(|| format!("hardware {id:#010x}"), |row| row.name.to_owned())
}
