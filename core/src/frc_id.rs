//! The 29-bit identifier scheme that DMC60C and Talon SRX share.
//!
//! Bits 28..24 device type, 23..16 manufacturer, 15..6 API, 5..0 device number (DMC60C guide, tables 1
//! to 3). The API field is documented as part of the base identifier (`msgidControl0` = 0x02060000),
//! so the codecs compare bases instead of fields.

/// Bits of the identifier that hold the device number.
pub const NUMBER_MASK: u32 = 0x3F;

/// Device number part of an identifier, 0 to 63.
#[must_use]
pub const fn number(id: u32) -> u8 {
    (id & NUMBER_MASK) as u8
}

/// The identifier without its device number.
#[must_use]
pub const fn base(id: u32) -> u32 {
    id & !NUMBER_MASK
}

/// A base identifier completed with a device number; number bits above the sixth are dropped.
#[must_use]
pub const fn with_number(base: u32, number: u8) -> u32 {
    base | (number as u32 & NUMBER_MASK)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_identifier_splits_and_joins() {
        let id = with_number(0x0206_1400, 5);
        assert_eq!((base(id), number(id)), (0x0206_1400, 5));
        assert_eq!(with_number(0x0206_1400, 0xFF), 0x0206_143F);
    }
}
