//! Finding devices.

use std::collections::BTreeMap;
use std::time::Duration;

use windlass_core::dialect::DialectKind;
use windlass_core::frame::Frame;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ImageType, id,
};
use windlass_core::params::table::ParameterId;

use super::{Address, Client, Device, Error, Selector};
use crate::transport::{Bus, BusError};

/// How long answers are collected (guide, "Enumeration and Device Discovery").
const WINDOW: Duration = Duration::from_millis(100);
/// Rounds of one [`Client::scan`].
const FEWEST_ROUNDS: usize = 3;
/// Rounds after which [`Client::scan`] is content with fewer answers than it once had.
const MOST_ROUNDS: usize = 10;
/// What each round is longer than the window, so that the rounds fall into different quarters of the
/// devices' tick of 500 µs.
const PHASE_SHIFT: Duration = Duration::from_micros(125);

/// Both answers of one device, as far as they came.
#[derive(Clone, Copy, Default)]
struct Answers {
    product_id: Option<u32>,
    versions: Option<FirmwareVersions>,
}

impl<B: Bus> Client<B> {
    /// One round: asks every device to report and collects answers for 100 ms. Devices with the same
    /// number stay apart by their sessions; a device whose first answer was lost is left out.
    ///
    /// # Errors
    /// The bus failed.
    pub fn enumerate(&mut self) -> Result<Vec<Device>, BusError> {
        self.enumerate_for(WINDOW)
    }

    fn enumerate_for(&mut self, window: Duration) -> Result<Vec<Device>, BusError> {
        self.send(&Frame::extended(id::ENUMERATE, []))?;
        let mut answers: BTreeMap<Address, Answers> = BTreeMap::new();
        let nothing: Option<()> = self.wait_for(window, |frame| {
            collect(&mut answers, frame);
            None
        })?;
        debug_assert!(nothing.is_none());
        let devices = answers.into_iter().filter_map(|(address, answers)| {
            Some(Device {
                address,
                product_id: Some(answers.product_id?),
                versions: answers.versions,
            })
        });
        Ok(devices.collect())
    }

    /// Rounds of [`Client::enumerate`] until one has as many answers as the best before it.
    ///
    /// One round is not enough: devices with the same number answer at the same time under the same
    /// identifier and can destroy each other's answers, which gives them new sessions. Each round
    /// therefore falls at another phase of the devices' 500 µs ticks, and only the sessions of the last
    /// round count.
    ///
    /// # Errors
    /// The bus failed.
    pub fn scan(&mut self) -> Result<Vec<Device>, BusError> {
        let mut most = 0;
        let mut devices = Vec::new();
        for round in 1..=MOST_ROUNDS {
            devices = self.enumerate_for(WINDOW + PHASE_SHIFT)?;
            most = most.max(devices.len());
            if round >= FEWEST_ROUNDS && devices.len() == most {
                break;
            }
        }
        Ok(devices)
    }

    /// The one device that `selector` names. A session is tried as it is before anything is enumerated,
    /// because enumerating can give devices with the same number new sessions.
    ///
    /// # Errors
    /// No device or several match, or the bus failed.
    pub fn find(&mut self, selector: &Selector) -> Result<Device, Error> {
        if let Some(device) = self.find_by_session(selector)? {
            return Ok(device);
        }
        let devices = self.scan()?;
        if devices.is_empty() {
            return Err(Error::NoDevice);
        }
        let matches = |device: &&Device| selector.matches(device.address);
        let mut found: Vec<Device> = devices.iter().filter(matches).copied().collect();
        if let Some(wanted) = selector.dialect {
            let numbered = std::mem::take(&mut found);
            for device in numbered {
                if self.is_driven_by(&device, wanted)? {
                    found.push(device);
                }
            }
        }
        match found.as_slice() {
            [device] => Ok(*device),
            [] => Err(Error::NotFound {
                selector: *selector,
                present: addresses(&devices),
            }),
            several => Err(Error::Ambiguous {
                selector: *selector,
                candidates: addresses(several),
            }),
        }
    }

    /// The dialect that drives the device; none if it does not tell, as bootloaders and other makers'
    /// DMC60C do.
    ///
    /// # Errors
    /// No answer, or the bus failed.
    pub fn dialect(&mut self, address: Address) -> Result<Option<DialectKind>, Error> {
        if let Some(dialect) = address.dialect() {
            return Ok(Some(dialect));
        }
        match self.parameter(address, ParameterId::Dialect) {
            Ok(value) => Ok(DialectKind::from_code(value.raw)),
            Err(Error::Refused { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// A device that does not tell its dialect is taken for any; a bootloader is not asked.
    fn is_driven_by(&mut self, device: &Device, wanted: DialectKind) -> Result<bool, Error> {
        let image = device.versions.map(|versions| versions.image);
        if image == Some(ImageType::Bootloader) {
            return Ok(true);
        }
        let dialect = self.dialect(device.address)?;
        Ok(dialect.is_none_or(|dialect| dialect == wanted))
    }

    fn find_by_session(&mut self, selector: &Selector) -> Result<Option<Device>, BusError> {
        let Some(session) = selector.session else {
            return Ok(None);
        };
        for manufacturer in Manufacturer::ALL {
            if !selector.allows(manufacturer) {
                continue;
            }
            let number = match selector.number {
                Some(number) => Some(number),
                None => self.number_of(session, manufacturer)?,
            };
            let Some(number) = number else {
                continue;
            };
            let address = Address {
                number,
                session,
                manufacturer,
            };
            if let Some(versions) = self.probe(address)? {
                return Ok(Some(Device {
                    address,
                    product_id: None,
                    versions: Some(versions),
                }));
            }
        }
        Ok(None)
    }

    /// Why a device did not answer: it may have another session by now.
    pub(super) fn silence(&mut self, address: Address, request: &str) -> Error {
        let devices = match self.scan() {
            Ok(devices) => devices,
            Err(error) => return error.into(),
        };
        let numbered: Vec<Address> = addresses(&devices)
            .into_iter()
            .filter(|present| {
                present.number == address.number && present.manufacturer == address.manufacturer
            })
            .collect();
        match numbered.as_slice() {
            [present] if present.session != address.session => Error::WrongSession {
                address,
                session: present.session,
            },
            _ => Error::NoAnswer {
                address,
                request: request.to_owned(),
            },
        }
    }
}

fn addresses(devices: &[Device]) -> Vec<Address> {
    devices.iter().map(|device| device.address).collect()
}

/// Sorts an enumeration answer into its device; the two differ by their length.
fn collect(answers: &mut BTreeMap<Address, Answers>, frame: &Frame) {
    let sender = frame
        .extended_id()
        .and_then(|raw| Manufacturer::sender(id::ENUMERATE_RESPONSE, raw));
    let Some((manufacturer, number)) = sender else {
        return;
    };
    let address = |session| Address {
        number,
        session,
        manufacturer,
    };
    if let Some(first) = EnumerateResponse0::parse(frame) {
        let entry = answers.entry(address(first.session)).or_default();
        entry.product_id = Some(first.product_id);
    } else if let Some(second) = EnumerateResponse1::parse(frame) {
        let entry = answers.entry(address(second.session)).or_default();
        entry.versions = Some(second.versions);
    }
}
