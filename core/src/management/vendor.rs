//! Vendor commands and the codes that answer them: the one table of the management channel.

/// What a vendor command does with the bytes that follow it, and which string it writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// `vcmdSetDevNumber`.
    SetDeviceNumber,
    /// `vcmdSetDevName` … `vcmdSetSN`.
    SetDescriptor(Descriptor),
    /// `vcmdFlashLEDS`.
    FlashLeds,
    /// `vcmdGetDescriptors`.
    GetDescriptors,
    /// `vcmdGetFwver`.
    GetFirmwareVersion,
    /// `vcmdGetFlashSeqnum`.
    GetFlashSequence,
    /// `vcmdEnterBootloader`.
    EnterBootloader,
    /// `vcmdSoftReset`.
    SoftReset,
    /// `vcmdEraseWriteFlashPage`.
    EraseWriteFlashPage,
    /// `vcmdJ1ShortTest` and `vcmdJ1OpenTest`.
    PinTest(PinTest),
    /// `vcmdGetPageCrcs` (own): what of an update is stored.
    GetPageCrcs,
    /// `vcmdRestoreFallback` (own): put the fallback image back.
    RestoreFallback,
    /// `vcmdGetBootStatus` (own).
    GetBootStatus,
    /// `vcmdFactoryReset` (own): settings back to their defaults; with a first parameter of 1 also device
    /// number and all strings.
    FactoryReset,
    /// `vcmdInstallKey` (own): accept signed images only from now on.
    InstallKey,
}

/// Declares the commands' codes and names once: as a table for people and hosts, and as a function without the
/// names for a device.
macro_rules! command_codes {
    ($( $code:literal $text:literal $command:ident $(($argument:path))?; )*) => {
        impl Command {
            /// Every command with its code and its name in the guide ("Vendor Commands", "Commands"); 0xE0 to
            /// 0xEF are this project's own (docs/updates.md).
            pub const TABLE: &[(u16, &'static str, Self)] =
                &[ $( ($code, $text, Self::$command $(($argument))?), )* ];

            /// The command of a 16-bit code; the whole word counts, 0x0161 is not 0x0061.
            #[must_use]
            pub const fn from_code(code: u16) -> Option<Self> {
                Some(match code {
                    $( $code => Self::$command $(($argument))?, )*
                    _ => return None,
                })
            }

            /// The command's code.
            #[must_use]
            pub const fn code(self) -> u16 {
                match self {
                    $( Self::$command $(($argument))? => $code, )*
                }
            }
        }
    };
}

command_codes! {
    0x01 "vcmdSetDevNumber" SetDeviceNumber;
    0x02 "vcmdSetDevName" SetDescriptor(Descriptor::DeviceName);
    0x03 "vcmdSetManName" SetDescriptor(Descriptor::ManufacturerName);
    0x04 "vcmdSetProdName" SetDescriptor(Descriptor::ProductName);
    0x05 "vcmdSetManDate" SetDescriptor(Descriptor::ManufactureDate);
    0x06 "vcmdSetHardwareVer" SetDescriptor(Descriptor::HardwareVersion);
    0x07 "vcmdSetSN" SetDescriptor(Descriptor::SerialNumber);
    0x50 "vcmdFlashLEDS" FlashLeds;
    0x60 "vcmdGetDescriptors" GetDescriptors;
    0x61 "vcmdGetFwver" GetFirmwareVersion;
    0x62 "vcmdGetFlashSeqnum" GetFlashSequence;
    0xE0 "vcmdGetPageCrcs" GetPageCrcs;
    0xE1 "vcmdRestoreFallback" RestoreFallback;
    0xE2 "vcmdGetBootStatus" GetBootStatus;
    0xE3 "vcmdFactoryReset" FactoryReset;
    0xE4 "vcmdInstallKey" InstallKey;
    0xF0 "vcmdEnterBootloader" EnterBootloader;
    0xF1 "vcmdSoftReset" SoftReset;
    0xF2 "vcmdEraseWriteFlashPage" EraseWriteFlashPage;
    0xF3 "vcmdJ1ShortTest" PinTest(PinTest::Short);
    0xF4 "vcmdJ1OpenTest" PinTest(PinTest::Open);
}

/// The two tests of the expansion header J1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinTest {
    /// `vcmdJ1ShortTest`: no pin may be connected to another one, to ground or to a supply.
    Short,
    /// `vcmdJ1OpenTest`: needs a fixture that joins pins 3–4, 5–7 and 8–9.
    Open,
}

/// Declares an enum of codes with the name that each has in the guide, in the order of the codes.
macro_rules! named_codes {
    (
        $(#[$enum_doc:meta])*
        pub enum $name:ident { $( $(#[$doc:meta])* $variant:ident = $code:literal, $text:literal; )* }
    ) => {
        $(#[$enum_doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum $name { $( $(#[$doc])* $variant = $code, )* }

        impl $name {
            /// Every value with its name, in the order of the codes.
            pub const TABLE: &[(Self, &'static str)] = &[ $( (Self::$variant, $text), )* ];

            /// The value of a code; `None` if the guide does not define it.
            #[must_use]
            pub const fn from_code(code: u8) -> Option<Self> {
                Some(match code {
                    $( $code => Self::$variant, )*
                    _ => return None,
                })
            }

            /// The value's name.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $( Self::$variant => $text, )* }
            }
        }
    };
}
pub(crate) use named_codes;

named_codes! {
    /// A pin of J1 that failed a test (`terc…`), named as on the header.
    pub enum TestPin {
        /// AIN1.
        AnalogIn = 1, "AIN1";
        /// FWDLIM.
        ForwardLimit = 2, "FWDLIM";
        /// REVLIM.
        ReverseLimit = 3, "REVLIM";
        /// QEA.
        EncoderA = 4, "QEA";
        /// QEB.
        EncoderB = 5, "QEB";
        /// QEIDX.
        EncoderIndex = 6, "QEIDX";
    }
}

named_codes! {
    /// Result codes of a vendor command: the low byte of `cerc`. Those from 0x20 on are this project's own
    /// (docs/updates.md).
    pub enum CommandCode {
        /// Done.
        NoError = 0, "cercNoError";
        /// The running image does not know the command.
        NotSupported = 1, "cercNotSupported";
        /// A parameter is not allowed.
        BadParameter = 2, "cercBadParameter";
        /// More data than announced.
        DataReceivedMore = 3, "cercDataRcvMore";
        /// The bootloader runs.
        InBootloader = 4, "cercInBootloader";
        /// The page's CRC is wrong.
        CrcMismatch = 5, "cercCrcMismatch";
        /// Erasing or writing failed.
        FlashWriteFailed = 6, "cercFlashWriteFailed";
        /// The restart that was asked for is over.
        AcknowledgeReset = 7, "cercAckReset";
        /// A test passed.
        TestPassed = 8, "cercTestPassed";
        /// A test failed; the high byte of `cerc` tells the pin.
        TestFailed = 9, "cercTestFailed";
        /// The page ends with no header of this project, or with a damaged one; nothing was written.
        NoImage = 0x20, "cercNoImage";
        /// The image is for another product; nothing was written.
        WrongProduct = 0x21, "cercWrongProduct";
        /// The image is for another hardware, or has pages that this one has no room for; nothing was
        /// written.
        WrongHardware = 0x22, "cercWrongHardware";
        /// The image's anti-rollback counter is too small; nothing was written.
        RollbackRefused = 0x23, "cercRollbackRefused";
        /// The page does not belong to the image, or does not follow what is stored: begin again with page
        /// 30. Nothing was written.
        PageOrder = 0x24, "cercPageOrder";
        /// The page was stored; pages of the image are still missing.
        ImageIncomplete = 0x25, "cercImageIncomplete";
        /// All pages are stored, and their CRC is not the header's.
        ImageCrc = 0x26, "cercImageCrc";
        /// All pages are stored, and the signature is missing or wrong.
        BadSignature = 0x27, "cercBadSignature";
        /// There is no fallback image.
        NoFallback = 0x28, "cercNoFallback";
        /// The key was not accepted: another one is installed and did not sign it, or this build knows no
        /// signatures.
        KeyRefused = 0x29, "cercKeyRefused";
        /// The change is in force and is written as soon as the drive is off: that takes an erase.
        SaveWaits = 0x2E, "cercSaveWaits";
        /// Not while the motor is driven.
        DriveRunning = 0x2F, "cercDriveRunning";
    }
}

/// Result codes of a parameter request (`perc…`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterError {
    /// `percBadParameter`: no such parameter.
    BadParameter = 1,
    /// `percBadValue`: the value is not allowed for this parameter.
    BadValue = 2,
}

/// The six strings that describe a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descriptor {
    /// `idfldSzDevName`, the user's name for the device.
    DeviceName = 1,
    /// `idfldSzManName`.
    ManufacturerName = 2,
    /// `idfldSzProdName`.
    ProductName = 3,
    /// `idfldSzManDate`, `mm/dd/yy`.
    ManufactureDate = 4,
    /// `idfldSzHardWareVer`, `x.y`.
    HardwareVersion = 5,
    /// `idfldSzSN`, 12 hexadecimal digits.
    SerialNumber = 6,
}

impl Descriptor {
    /// Every string in the order of its field identifier.
    pub const ALL: [Self; 6] = [
        Self::DeviceName,
        Self::ManufacturerName,
        Self::ProductName,
        Self::ManufactureDate,
        Self::HardwareVersion,
        Self::SerialNumber,
    ];

    /// Longest string in bytes, without the terminator (guide, field table; device name 64 and serial
    /// number 12 by `docs/dmc60c.md`).
    #[must_use]
    pub const fn capacity(self) -> usize {
        match self {
            Self::DeviceName => 64,
            Self::ManufacturerName | Self::ProductName => 28,
            Self::ManufactureDate => 20,
            Self::HardwareVersion => 8,
            Self::SerialNumber => 12,
        }
    }

    /// The string of a field identifier.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|entry| *entry as u8 == code)
    }
}
