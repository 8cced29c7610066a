//! As what a controller is discovered and managed: a table of values that the driving dialect chooses.

use super::vendor::Descriptor;
use super::wire::id;
use crate::frc_id::{base, number, with_number};

/// Type, manufacturer and API class of an identifier: bits 28 to 16, and 15 to 10 with two bits of the API
/// index, which tell these four apart.
const CLASS_MASK: u32 = 0x1FFF_FF00;
const ENUMERATE_CLASS: u32 = id::ENUMERATE & CLASS_MASK;
const ANSWER_CLASS: u32 = 0x0204_F000;
const VENDOR_CLASS: u32 = 0x0204_FC00;
const PARAMETER_CLASS: u32 = 0x0204_FD00;
/// What the identifiers of enumeration and vendor commands differ in under the two manufacturers.
const MAKERS_DIFFER: u32 = id::VENDOR_COMMAND ^ VENDOR_CLASS;
/// The same of the parameter frames.
const PARAMETERS_DIFFER: u32 = id::PARAMETER_REQUEST ^ PARAMETER_CLASS;

/// Whose identifiers the management channel uses. Frames, lengths and rules are the same under each; two
/// controllers of different manufacturers can have the same number without ever sending one identifier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Manufacturer {
    /// 6, as the DMC60C guide has it.
    #[default]
    Digilent,
    /// 4, the Talon SRX's. Its vendor has not published how these devices are managed: that it goes as with
    /// the DMC60C is this project's own (docs/talon-srx.md). Parameter frames have a place of their own
    /// behind the vendor commands, because the Talon has other ones at the place of the DMC60C's.
    CrossTheRoad,
}

impl Manufacturer {
    /// Every manufacturer.
    pub const ALL: [Self; 2] = [Self::Digilent, Self::CrossTheRoad];

    /// The identifier under this manufacturer of a frame that has `guide` in the DMC60C guide.
    #[must_use]
    pub const fn identifier(self, guide: u32) -> u32 {
        match (self, base(guide)) {
            (Self::Digilent, _) | (_, id::ENUMERATE) => guide,
            (_, id::PARAMETER_REQUEST | id::PARAMETER_RESPONSE | id::PARAMETER_SET) => {
                guide ^ PARAMETERS_DIFFER
            }
            _ => guide ^ MAKERS_DIFFER,
        }
    }

    /// The identifier in the guide of a frame that has `raw` under this manufacturer; `None`, or one that
    /// the guide does not know, if that is no frame of the channel.
    #[must_use]
    pub const fn guide_identifier(self, raw: u32) -> Option<u32> {
        match (self, raw & CLASS_MASK) {
            (Self::Digilent, _) | (_, ENUMERATE_CLASS) => Some(raw),
            (_, ANSWER_CLASS | VENDOR_CLASS) => Some(raw ^ MAKERS_DIFFER),
            (_, PARAMETER_CLASS) => Some(raw ^ PARAMETERS_DIFFER),
            _ => None,
        }
    }

    /// The identifier of device `number` for the guide's base identifier.
    #[must_use]
    pub const fn addressed(self, guide: u32, number: u8) -> u32 {
        with_number(self.identifier(guide), number)
    }

    /// The manufacturer under which `raw` is the guide's base identifier `guide`, and the device number.
    #[must_use]
    pub fn sender(guide: u32, raw: u32) -> Option<(Self, u8)> {
        let found = Self::ALL
            .into_iter()
            .find(|maker| maker.identifier(guide) == base(raw))?;
        Some((found, number(raw)))
    }
}

/// What a controller says it is. A value of each dialect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Whose identifiers its management channel uses.
    pub manufacturer: Manufacturer,
    /// `pdid` of the enumeration answer. Firmware images are for the board, whatever dialect drives it, and
    /// name [`PRODUCT_DMC60C`](crate::node::PRODUCT_DMC60C).
    pub product_id: u32,
    /// Manufacturer's name as long as none is stored.
    pub manufacturer_name: &'static str,
    /// Product's name as long as none is stored.
    pub product_name: &'static str,
    /// Smallest number that can be given.
    pub first_number: u8,
    /// Largest number that a device can have.
    pub last_number: u8,
}

impl Identity {
    /// The DMC60C (guide, field table and `vcmdSetDevNumber`; product id by docs/dmc60c.md).
    pub const DMC60C: Self = Self {
        manufacturer: Manufacturer::Digilent,
        product_id: crate::node::PRODUCT_DMC60C,
        manufacturer_name: "Digilent",
        product_name: "Digilent DMC60C",
        first_number: 1,
        last_number: 63,
    };

    /// What the device reports as long as nothing has been stored (guide, field table).
    #[must_use]
    pub const fn default_text(&self, which: Descriptor) -> &'static str {
        match which {
            Descriptor::DeviceName => "Motor Controller",
            Descriptor::ManufacturerName => self.manufacturer_name,
            Descriptor::ProductName => self.product_name,
            Descriptor::ManufactureDate
            | Descriptor::HardwareVersion
            | Descriptor::SerialNumber => "UNKNOWN",
        }
    }

    /// The number that a command asks for, if this kind of device can be given it.
    #[must_use]
    pub fn assignable(&self, asked: u16) -> Option<u8> {
        let number = u8::try_from(asked).ok()?;
        (self.first_number..=self.last_number)
            .contains(&number)
            .then_some(number)
    }

    /// The stored number, or 0 if this kind of device cannot have it.
    #[must_use]
    pub const fn number(&self, stored: u8) -> u8 {
        if stored <= self.last_number {
            stored
        } else {
            0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_identifiers_of_both_manufacturers() {
        use Manufacturer::{CrossTheRoad, Digilent};
        for (guide, talon) in [
            (id::ENUMERATE, 0x0000_0240),
            (id::ENUMERATE_RESPONSE, 0x0204_F000),
            (id::VENDOR_COMMAND, 0x0204_FC00),
            (id::VENDOR_DATA_OUT, 0x0204_FC40),
            (id::VENDOR_DATA_IN, 0x0204_FC80),
            (id::VENDOR_STATUS, 0x0204_FCC0),
            (id::PARAMETER_REQUEST, 0x0204_FD00),
            (id::PARAMETER_RESPONSE, 0x0204_FD40),
            (id::PARAMETER_SET, 0x0204_FD80),
        ] {
            assert_eq!(CrossTheRoad.addressed(guide, 5), talon | 5);
            assert_eq!(CrossTheRoad.guide_identifier(talon | 5), Some(guide | 5));
            assert_eq!(Digilent.addressed(guide, 5), guide | 5);
            assert_eq!(Digilent.guide_identifier(guide | 5), Some(guide | 5));
            if guide != id::ENUMERATE {
                assert_eq!(
                    Manufacturer::sender(guide, talon | 7),
                    Some((CrossTheRoad, 7))
                );
                assert_eq!(Manufacturer::sender(guide, guide | 7), Some((Digilent, 7)));
            }
        }
    }

    #[test]
    fn every_other_identifier_belongs_to_no_channel() {
        let known = [
            id::ENUMERATE,
            id::ENUMERATE_RESPONSE,
            id::VENDOR_COMMAND,
            id::VENDOR_DATA_OUT,
            id::VENDOR_DATA_IN,
            id::VENDOR_STATUS,
            id::PARAMETER_REQUEST,
            id::PARAMETER_RESPONSE,
            id::PARAMETER_SET,
        ];
        for maker in Manufacturer::ALL {
            let mut found = 0;
            // Every API field of the two, of another manufacturer, of another device type and of broadcasts.
            for upper in [0, 0x0204_0000, 0x0206_0000, 0x0205_0000, 0x0104_0000] {
                for raw in (0..0x400).map(|api| upper | api << 6) {
                    let guide = maker.guide_identifier(raw);
                    if let Some(guide) = guide.filter(|guide| known.contains(guide)) {
                        assert_eq!(maker.identifier(guide), raw, "{maker:?} {raw:#x}");
                        found += 1;
                    }
                }
            }
            assert_eq!(found, known.len(), "{maker:?}");
        }
    }
}
