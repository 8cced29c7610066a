//! What a device tells about itself.

use std::fmt;

use windlass_core::dialect::{self, DialectKind};
use windlass_core::frame::Frame;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::vendor::Descriptor;
use windlass_core::management::wire::{FirmwareVersions, ImageType};

/// Where a device is reached: under whose identifiers, its number, and the session that tells it from others
/// with that number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Device number, 0 if none has been assigned.
    pub number: u8,
    /// Session id, never 0; it changes whenever the device loses the bus or restarts.
    pub session: u16,
    /// Whose identifiers it is managed with.
    pub manufacturer: Manufacturer,
}

impl Address {
    /// A frame of the guide as this device takes it.
    pub(super) fn frame(&self, guide: &Frame) -> Frame {
        guide.with_extended_id(self.manufacturer.identifier(guide.raw_id()))
    }

    /// The dialect that drives this device, if its manufacturer tells: a DMC60C's channel serves several.
    #[must_use]
    pub fn dialect(&self) -> Option<DialectKind> {
        if self.manufacturer == Manufacturer::default() {
            return None;
        }
        let maker = |kind: &DialectKind| kind.identity().manufacturer == self.manufacturer;
        dialect::ALL.iter().copied().find(maker)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}@{:#06x}", self.number, self.session)
    }
}

/// A device that answered the enumeration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Device {
    /// Where it is reached.
    pub address: Address,
    /// `pdid`: product, variant and firmware id; `None` if the device was asked by its session instead of
    /// enumerated.
    pub product_id: Option<u32>,
    /// Running image and versions; `None` if the second answer was lost.
    pub versions: Option<FirmwareVersions>,
}

impl Device {
    /// The running image as a word.
    #[must_use]
    pub const fn image_name(&self) -> &'static str {
        match self.versions {
            Some(versions) => image_name(versions.image),
            None => "unknown",
        }
    }

    /// Versions of the application and the bootloader as text. Without an application that of a Talon is
    /// 255.255, as its manual has it (2.3.2).
    pub(crate) fn version_names(&self) -> (String, String) {
        let Some(versions) = self.versions else {
            return ("?".to_owned(), "?".to_owned());
        };
        let application = match self.address.manufacturer {
            Manufacturer::CrossTheRoad => Version(versions.application).numbers(),
            Manufacturer::Digilent => Version(versions.application).to_string(),
        };
        (application, Version(versions.bootloader).to_string())
    }
}

/// A product id as text.
pub(crate) fn product_name(product_id: Option<u32>) -> String {
    product_id.map_or_else(|| "?".to_owned(), |id| format!("{id:#010x}"))
}

/// An image type as a word.
pub(crate) const fn image_name(image: ImageType) -> &'static str {
    match image {
        ImageType::Application => "application",
        ImageType::Bootloader => "bootloader",
        ImageType::AuxiliaryBootloader => "auxiliary bootloader",
        ImageType::Reserved => "reserved",
    }
}

/// A firmware version: major in the high byte, minor in the low byte, both binary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version(pub u16);

impl Version {
    /// What a device without an application reports.
    pub const NONE: Self = Self(0xFFFF);

    fn numbers(self) -> String {
        let [major, minor] = self.0.to_be_bytes();
        format!("{major}.{minor}")
    }
}

impl fmt::Display for Version {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::NONE {
            return out.write_str("none");
        }
        out.write_str(&self.numbers())
    }
}

/// The strings of a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Descriptors {
    /// The user's name for the device.
    pub device_name: String,
    /// Manufacturer.
    pub manufacturer_name: String,
    /// Product.
    pub product_name: String,
    /// Date of manufacture, `mm/dd/yy`.
    pub manufacture_date: String,
    /// Hardware version, `x.y`.
    pub hardware_version: String,
    /// Serial number, 12 hexadecimal digits.
    pub serial_number: String,
}

impl Descriptors {
    /// Reads the field-separated stream of `vcmdGetDescriptors`. Unknown fields are skipped; `None` if
    /// a field is cut short.
    #[must_use]
    pub fn parse(mut stream: &[u8]) -> Option<Self> {
        let mut descriptors = Self::default();
        while let [field, count, rest @ ..] = stream {
            let (text, after) = rest.split_at_checked(usize::from(*count))?;
            if let Some(field) = Descriptor::from_code(*field) {
                *descriptors.text_mut(field) = String::from_utf8_lossy(text).into_owned();
            }
            stream = after;
        }
        stream.is_empty().then_some(descriptors)
    }

    /// One of the strings.
    #[must_use]
    pub fn text(&self, descriptor: Descriptor) -> &str {
        match descriptor {
            Descriptor::DeviceName => &self.device_name,
            Descriptor::ManufacturerName => &self.manufacturer_name,
            Descriptor::ProductName => &self.product_name,
            Descriptor::ManufactureDate => &self.manufacture_date,
            Descriptor::HardwareVersion => &self.hardware_version,
            Descriptor::SerialNumber => &self.serial_number,
        }
    }

    fn text_mut(&mut self, descriptor: Descriptor) -> &mut String {
        match descriptor {
            Descriptor::DeviceName => &mut self.device_name,
            Descriptor::ManufacturerName => &mut self.manufacturer_name,
            Descriptor::ProductName => &mut self.product_name,
            Descriptor::ManufactureDate => &mut self.manufacture_date,
            Descriptor::HardwareVersion => &mut self.hardware_version,
            Descriptor::SerialNumber => &mut self.serial_number,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_guide_s_example_stream_is_read() {
        // Guide, "Device Descriptors"; the serial number's count is 12 (docs/dmc60c.md).
        let stream = b"\x01\x06DMC60C\x02\x0fDigilent DMC60C\x06\x0c2103343A79F2";
        let descriptors = Descriptors::parse(stream).unwrap();
        assert_eq!(descriptors.device_name, "DMC60C");
        assert_eq!(descriptors.text(Descriptor::SerialNumber), "2103343A79F2");
        assert_eq!(descriptors.product_name, "");
    }

    #[test]
    fn a_cut_stream_is_refused_and_unknown_fields_are_skipped() {
        assert!(Descriptors::parse(b"\x01\x06DMC").is_none());
        assert!(Descriptors::parse(b"\x01").is_none());
        let read = Descriptors::parse(b"\x63\x02xx\x01\x01A").unwrap();
        assert_eq!(read.device_name, "A");
    }

    #[test]
    fn versions_are_written_as_major_and_minor() {
        assert_eq!(Version(0x0117).to_string(), "1.23");
        assert_eq!(Version(0x0109).to_string(), "1.9");
        assert_eq!(Version::NONE.to_string(), "none");
    }
}
