//! One update of one device.

use std::time::Duration;

use windlass_core::boot::image::{Hardware, NO_VERSION};
use windlass_core::boot::status::BootStatus;
use windlass_core::dialect::{self, DialectKind};
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::vendor::{CommandCode, Descriptor};
use windlass_core::management::wire::ImageType;
use windlass_core::node::PRODUCT_DMC60C;

use super::{FlashError, Observer, Options, Phase, Report};
use crate::client::{self, Address, Client, Device, Version};
use crate::image::Image;
use crate::transport::Bus;

/// Times that a device is told to restart.
const RESTARTS: u32 = 3;
/// Times in a row that a device may be lost without having stored another page.
const FRUITLESS: u32 = 4;
/// Time in which a driven device is sure to have said so: several periods of its status frame.
const DRIVE_CHECK: Duration = Duration::from_millis(120);
/// What a device without a serial number reports.
const NO_SERIAL: &str = "UNKNOWN";

pub(super) struct Session<'a, B: Bus> {
    pub(super) client: &'a mut Client<B>,
    pub(super) observer: &'a mut dyn Observer,
    pub(super) options: Options,
    pub(super) address: Address,
    product: Option<u32>,
    serial: Option<String>,
    before: Option<Version>,
    /// The device has been looked at, and nothing speaks against going on.
    looked: bool,
    /// The bootloader runs because this session asked for it.
    entered: bool,
    /// The device has everything and has committed it.
    committed: bool,
    /// Pages of the image that the device is known to have.
    pub(super) stored: usize,
    /// Pages of the image.
    pub(super) of: usize,
    pub(super) sent: usize,
    /// How many times longer than usual a page's answer is waited for.
    pub(super) slowness: u32,
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
            looked: false,
            entered: false,
            committed: false,
            stored: 0,
            of: 0,
            sent: 0,
            slowness: 1,
            started,
        }
    }

    pub(super) fn check_first(mut self, image: &Image) -> Result<(), FlashError> {
        let status = self.look()?;
        self.check(image, status.as_ref())
    }

    pub(super) fn update(mut self, image: &Image) -> Result<Report, FlashError> {
        let updated = self.again(|session| {
            if !session.looked {
                let status = session.look()?;
                session.check(image, status.as_ref())?;
                session.of = image.pages().len();
                session.looked = true;
            }
            session.update_once(image)
        });
        self.unless_unchanged(updated)?;
        self.report(Version(image.header().identity.version))
    }

    pub(super) fn roll_back(mut self) -> Result<Report, FlashError> {
        let mut version = NO_VERSION;
        let restored = self.again(|session| {
            if !session.looked {
                session.look()?;
                session.looked = true;
            }
            session.roll_back_once(&mut version)
        });
        self.unless_unchanged(restored)?;
        self.report(Version(version))
    }

    /// Installs a public key in the bootloader and goes back to the application, if there is one.
    pub(super) fn install_key(mut self, order: &[u8]) -> Result<(), FlashError> {
        self.look()?;
        self.enter()?;
        let installed = self.client.install_key(self.address, order);
        self.unless_unchanged(installed.map_err(|error| match error {
            client::Error::Refused { code, .. } if code == CommandCode::NotSupported.name() => {
                FlashError::NoSignatures(self.address)
            }
            other => other.into(),
        }))?;
        self.leave();
        Ok(())
    }

    /// After an error with nothing sent, the device goes back to the application that it still has.
    fn unless_unchanged(&mut self, result: Result<(), FlashError>) -> Result<(), FlashError> {
        let Err(error) = result else {
            return Ok(());
        };
        let is_reachable = !matches!(
            error,
            FlashError::Lost { .. } | FlashError::Client(client::Error::Bus(_))
        );
        if self.sent > 0 || !is_reachable || !self.leave() {
            return Err(error);
        }
        Err(match error {
            FlashError::Cancelled { address, .. } => FlashError::CancelledEarly(address),
            other => other,
        })
    }

    /// Restarts a bootloader that this session has entered and that has an application; true if it did.
    fn leave(&mut self) -> bool {
        let versions = self.client.firmware_versions(self.address);
        let has_application = versions.is_ok_and(|versions| {
            versions.image != ImageType::Application && versions.application != NO_VERSION
        });
        if !self.entered || !has_application {
            return false;
        }
        self.observer.phase(Phase::Restart);
        // If this fails, the device starts its application at the next power-on.
        self.client.soft_reset(self.address).is_ok()
    }

    fn report(self, version: Version) -> Result<Report, FlashError> {
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
            pages: self.of,
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
        if let Some(product_id) = self.product {
            self.product = Some(image_product(product_id));
        }
        if versions.image == ImageType::Application {
            self.client.listen(DRIVE_CHECK)?;
            if self.is_driving() {
                return Err(FlashError::Driving(self.address));
            }
        }
        Ok(self.client.boot_status(self.address)?)
    }

    /// Refuses an image that this device would refuse.
    pub(super) fn check(
        &self,
        image: &Image,
        status: Option<&BootStatus>,
    ) -> Result<(), FlashError> {
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
        if status.key_installed && !image.header().signed {
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
            if fruitless > FRUITLESS {
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
                return Err(self.cancelled());
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

    pub(super) fn cancelled(&self) -> FlashError {
        FlashError::Cancelled {
            address: self.address,
            stored: self.stored,
            of: self.of,
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
            self.entered = true;
            let restarted = self.client.enter_bootloader(self.address);
            self.restarted(restarted)?;
        }
        match self.image()? {
            ImageType::Application => Err(self.silence("vcmdEnterBootloader").into()),
            _ => Ok(()),
        }
    }

    /// The result of a restart, except that silence and statuses of something else are no errors: the
    /// acknowledgement may be lost, or the late answer to a page may come first. What runs is asked for anyway.
    fn restarted(&mut self, result: Result<Address, client::Error>) -> Result<(), client::Error> {
        match result {
            Ok(address) => self.address = address,
            Err(client::Error::NoAnswer { .. }) => {}
            Err(client::Error::Refused { code, .. })
                if code != CommandCode::NotSupported.name() => {}
            Err(other) => return Err(other),
        }
        Ok(())
    }

    /// True if the device reports that it drives.
    fn is_driving(&self) -> bool {
        let now = self.client.now();
        let number = self.address.number;
        match self.address.manufacturer {
            Manufacturer::Digilent => {
                let status = self.client.status(number);
                let general = status.and_then(|status| status.general.as_ref());
                general.is_some_and(|live| !live.is_stale(now) && live.value.duty != 0)
            }
            Manufacturer::CrossTheRoad => {
                let status = self.client.talon_status(number);
                let general = status.and_then(|status| status.general);
                general.is_some_and(|live| {
                    now.saturating_sub(live.at) <= DRIVE_CHECK && live.value.throttle != 0
                })
            }
        }
    }

    fn image(&mut self) -> Result<ImageType, FlashError> {
        Ok(self.client.firmware_versions(self.address)?.image)
    }

    pub(super) fn silence(&self, request: impl Into<String>) -> client::Error {
        client::Error::NoAnswer {
            address: self.address,
            request: request.into(),
        }
    }

    /// Restarts the device and waits until the version is read from its application.
    fn start(&mut self, wanted: Version) -> Result<(), FlashError> {
        for _ in 0..RESTARTS {
            if self.image()? == ImageType::Application {
                break;
            }
            self.observer.phase(Phase::Restart);
            let restarted = self.client.soft_reset(self.address);
            self.restarted(restarted)?;
        }
        self.observer.phase(Phase::Confirm);
        let address = self.address;
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

/// The product that images for a device have to be for. Controllers of this project say what their dialect is;
/// images are for the boards, whatever dialect drives them.
fn image_product(product_id: u32) -> u32 {
    let is_own = |kind: &DialectKind| kind.identity().product_id == product_id;
    if dialect::ALL.iter().any(is_own) {
        return PRODUCT_DMC60C;
    }
    product_id
}

fn hardware_name(id: u32) -> String {
    Hardware::from_id(id).map_or_else(|| format!("hardware {id:#010x}"), |row| row.name.to_owned())
}
