//! The frames of the management channel, both ways: enumeration, vendor commands, parameters.
//!
//! Source: DMC60C CAN Protocol Guide, "Enumeration and Device Discovery", "Vendor Commands" and
//! "Configuration Parameters"; byte order by `docs/dmc60c.md`. Every parser has one length gate and gives
//! `None` for anything else.

use crate::frame::Frame;
use crate::frc_id::with_number;

/// Base identifiers (guide: message identifier tables of each section).
pub mod id {
    /// Enumeration request `msgidEnum`, addressed to every device.
    pub const ENUMERATE: u32 = 0x0000_0240;
    /// Enumeration answers `msgidEnumResp`.
    pub const ENUMERATE_RESPONSE: u32 = 0x0206_F000;
    /// Vendor command `msgidVendorCmd`.
    pub const VENDOR_COMMAND: u32 = 0x0206_FC00;
    /// Bulk data to the device `msgidVendorDout`.
    pub const VENDOR_DATA_OUT: u32 = 0x0206_FC40;
    /// Bulk data from the device `msgidVendorDin`.
    pub const VENDOR_DATA_IN: u32 = 0x0206_FC80;
    /// Vendor status `msgidVendorSts`.
    pub const VENDOR_STATUS: u32 = 0x0206_FCC0;
    /// Parameter request `msgidParamReq`.
    pub const PARAMETER_REQUEST: u32 = 0x0206_1800;
    /// Parameter response `msgidParamResp`.
    pub const PARAMETER_RESPONSE: u32 = 0x0206_1840;
    /// Parameter set `msgidParamSet`.
    pub const PARAMETER_SET: u32 = 0x0206_1880;
}

/// Highest device number; 0 means that none has been assigned (guide, `vcmdSetDevNumber`).
pub const MAX_DEVICE_NUMBER: u8 = 63;

/// Which kind of firmware runs (`imgtyp`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageType {
    /// Application.
    #[default]
    Application,
    /// Bootloader.
    Bootloader,
    /// Auxiliary bootloader.
    AuxiliaryBootloader,
    /// The reserved code 3.
    Reserved,
}

impl ImageType {
    /// The image type of a code; only its two low bits count.
    #[must_use]
    pub const fn from_code(code: u16) -> Self {
        match code & 3 {
            0 => Self::Application,
            1 => Self::Bootloader,
            2 => Self::AuxiliaryBootloader,
            _ => Self::Reserved,
        }
    }

    /// The 2-bit code.
    #[must_use]
    pub const fn code(self) -> u16 {
        self as u16
    }
}

/// `ENUMRSP0`, first answer to an enumeration request (6 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnumerateResponse0 {
    /// `sessid`.
    pub session: u16,
    /// `pdid`: product (12 bits), variant (12 bits), firmware id (8 bits).
    pub product_id: u32,
}

impl EnumerateResponse0 {
    /// Reads the frame's data; `None` unless it has exactly 6 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [s0, s1, p0, p1, p2, p3] = *frame.exact::<6>()?;
        Some(Self {
            session: u16::from_le_bytes([s0, s1]),
            product_id: u32::from_le_bytes([p0, p1, p2, p3]),
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [s0, s1] = self.session.to_le_bytes();
        let [p0, p1, p2, p3] = self.product_id.to_le_bytes();
        Frame::extended(
            with_number(id::ENUMERATE_RESPONSE, number),
            [s0, s1, p0, p1, p2, p3],
        )
    }
}

/// Firmware versions and the kind of the running image, the common part of `ENUMRSP1` and `FWVERRSP`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FirmwareVersions {
    /// `imgtyp` of the flags.
    pub image: ImageType,
    /// `fwverApp`, major and minor byte; 0xFFFF while there is no application.
    pub application: u16,
    /// `fwverBoot`.
    pub bootloader: u16,
}

impl FirmwareVersions {
    /// `FWVERRSP` as bytes.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; 6] {
        let [f0, f1] = self.image.code().to_le_bytes();
        let [a0, a1] = self.application.to_le_bytes();
        let [b0, b1] = self.bootloader.to_le_bytes();
        [f0, f1, a0, a1, b0, b1]
    }

    /// Reads the bytes of `FWVERRSP`.
    #[must_use]
    pub const fn from_bytes([f0, f1, a0, a1, b0, b1]: [u8; 6]) -> Self {
        Self {
            image: ImageType::from_code(u16::from_le_bytes([f0, f1])),
            application: u16::from_le_bytes([a0, a1]),
            bootloader: u16::from_le_bytes([b0, b1]),
        }
    }
}

/// `ENUMRSP1`, second answer to an enumeration request (8 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnumerateResponse1 {
    /// `sessid`.
    pub session: u16,
    /// Running image and versions.
    pub versions: FirmwareVersions,
}

impl EnumerateResponse1 {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [s0, s1, f0, f1, a0, a1, b0, b1] = *frame.exact::<8>()?;
        Some(Self {
            session: u16::from_le_bytes([s0, s1]),
            versions: FirmwareVersions::from_bytes([f0, f1, a0, a1, b0, b1]),
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [s0, s1] = self.session.to_le_bytes();
        let [f0, f1, a0, a1, b0, b1] = self.versions.to_bytes();
        Frame::extended(
            with_number(id::ENUMERATE_RESPONSE, number),
            [s0, s1, f0, f1, a0, a1, b0, b1],
        )
    }
}

/// `VENDORCMD` (8 bytes): four 16-bit words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VendorCommand {
    /// `sessid` of the addressed device.
    pub session: u16,
    /// `cmd`, see [`super::vendor`].
    pub command: u16,
    /// `PARAM1`.
    pub param1: u16,
    /// `PARAM2`.
    pub param2: u16,
}

impl VendorCommand {
    /// Reads the frame's data; `None` unless it has exactly 8 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [s0, s1, c0, c1, a0, a1, b0, b1] = *frame.exact::<8>()?;
        Some(Self {
            session: u16::from_le_bytes([s0, s1]),
            command: u16::from_le_bytes([c0, c1]),
            param1: u16::from_le_bytes([a0, a1]),
            param2: u16::from_le_bytes([b0, b1]),
        })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [s0, s1] = self.session.to_le_bytes();
        let [c0, c1] = self.command.to_le_bytes();
        let [a0, a1] = self.param1.to_le_bytes();
        let [b0, b1] = self.param2.to_le_bytes();
        Frame::extended(
            with_number(id::VENDOR_COMMAND, number),
            [s0, s1, c0, c1, a0, a1, b0, b1],
        )
    }
}

/// `VENDORSTS` (4 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VendorStatus {
    /// `cerc`: the error code in the low byte; after a failed pin test the pin in the high byte.
    pub code: u16,
    /// `cb`: bytes that will follow on `msgidVendorDin`.
    pub byte_count: u16,
}

impl VendorStatus {
    /// Reads the frame's data; `None` unless it has exactly 4 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [c0, c1, n0, n1] = *frame.exact::<4>()?;
        Some(Self {
            code: u16::from_le_bytes([c0, c1]),
            byte_count: u16::from_le_bytes([n0, n1]),
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [c0, c1] = self.code.to_le_bytes();
        let [n0, n1] = self.byte_count.to_le_bytes();
        Frame::extended(with_number(id::VENDOR_STATUS, number), [c0, c1, n0, n1])
    }
}

/// `PARAMREQ` (3 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterRequest {
    /// `sessid` of the addressed device.
    pub session: u16,
    /// `paramid`.
    pub parameter: u8,
}

impl ParameterRequest {
    /// Reads the frame's data; `None` unless it has exactly 3 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [s0, s1, parameter] = *frame.exact::<3>()?;
        Some(Self {
            session: u16::from_le_bytes([s0, s1]),
            parameter,
        })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [s0, s1] = self.session.to_le_bytes();
        Frame::extended(
            with_number(id::PARAMETER_REQUEST, number),
            [s0, s1, self.parameter],
        )
    }
}

/// `PARAMSET` (7 bytes).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterSet {
    /// `sessid` of the addressed device.
    pub session: u16,
    /// `paramid`.
    pub parameter: u8,
    /// `value`; its meaning depends on the parameter.
    pub value: u32,
}

impl ParameterSet {
    /// Reads the frame's data; `None` unless it has exactly 7 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [s0, s1, parameter, v0, v1, v2, v3] = *frame.exact::<7>()?;
        Some(Self {
            session: u16::from_le_bytes([s0, s1]),
            parameter,
            value: u32::from_le_bytes([v0, v1, v2, v3]),
        })
    }

    /// The frame for device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [s0, s1] = self.session.to_le_bytes();
        let [v0, v1, v2, v3] = self.value.to_le_bytes();
        Frame::extended(
            with_number(id::PARAMETER_SET, number),
            [s0, s1, self.parameter, v0, v1, v2, v3],
        )
    }
}

/// `PARAMRESP` (6 bytes). It carries no session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterResponse {
    /// `paramid` that was requested or set.
    pub parameter: u8,
    /// `value` in force, 0 after an error.
    pub value: u32,
    /// `perc`, see [`super::vendor::ParameterError`].
    pub code: u8,
}

impl ParameterResponse {
    /// Reads the frame's data; `None` unless it has exactly 6 bytes.
    #[must_use]
    pub fn parse(frame: &Frame) -> Option<Self> {
        let [parameter, v0, v1, v2, v3, code] = *frame.exact::<6>()?;
        Some(Self {
            parameter,
            value: u32::from_le_bytes([v0, v1, v2, v3]),
            code,
        })
    }

    /// The frame of device `number`.
    #[must_use]
    pub const fn emit(&self, number: u8) -> Frame {
        let [v0, v1, v2, v3] = self.value.to_le_bytes();
        Frame::extended(
            with_number(id::PARAMETER_RESPONSE, number),
            [self.parameter, v0, v1, v2, v3, self.code],
        )
    }
}
