//! What the bootloader tells about itself (`vcmdGetBootStatus`).

/// Why a controller runs what it runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reason {
    /// The application runs.
    Application = 0,
    /// The bootloader was asked for (`vcmdEnterBootloader`).
    #[default]
    Requested = 1,
    /// The slot holds no image and no update has begun.
    Empty = 2,
    /// An update has begun and not ended.
    UpdateIncomplete = 3,
    /// The image was whole once, and its CRC is wrong now.
    ImageDamaged = 4,
    /// The image was on trial, failed three times, and there is no other one to put back.
    TrialFailed = 5,
    /// An image was to be put back from the fallback slot, and writing failed.
    RestoreFailed = 6,
    /// The confirmed image has failed eight times in a row before it answered.
    CrashLoop = 7,
}

impl Reason {
    /// Every reason with its description, in the order of the codes.
    pub const TABLE: [(Self, &'static str); 8] = [
        (Self::Application, "the application runs"),
        (Self::Requested, "the bootloader was asked for"),
        (Self::Empty, "there is no application"),
        (Self::UpdateIncomplete, "an update is not complete"),
        (Self::ImageDamaged, "the application is damaged"),
        (
            Self::TrialFailed,
            "the application failed its trial and there is no other one",
        ),
        (Self::RestoreFailed, "restoring the fallback image failed"),
        (
            Self::CrashLoop,
            "the application fails again and again before it answers",
        ),
    ];

    /// The reason of a code.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        Self::TABLE
            .into_iter()
            .map(|row| row.0)
            .find(|reason| *reason as u8 == code)
    }
}

/// Bytes of [`BootStatus`] on the wire.
pub const STATUS_LENGTH: usize = 32;
/// First byte of [`BootStatus`] on the wire.
pub const STATUS_FORMAT: u8 = 1;

/// State of the slots, read by the host before and during an update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BootStatus {
    /// Why the controller runs what it runs.
    pub reason: Reason,
    /// The application's image has been confirmed.
    pub confirmed: bool,
    /// A key is installed: only signed images are accepted.
    pub key_installed: bool,
    /// The controller has a fallback slot.
    pub has_fallback: bool,
    /// Resets by watchdog or fault since the image was committed, counted until it is confirmed.
    pub trial_failures: u8,
    /// Version of the committed application, 0xFFFF if there is none.
    pub application: u16,
    /// Version of the fallback image, 0xFFFF if there is none.
    pub fallback: u16,
    /// Smallest anti-rollback counter that is accepted.
    pub rollback: u32,
    /// Pages that are stored whole, bit 0 = page 0.
    pub stored: u32,
    /// Pages that the header in the slot asks for; 0 without a header.
    pub wanted: u32,
    /// Product id that images have to have.
    pub product: u32,
    /// Hardware id that images have to have.
    pub hardware: u32,
    /// Pages that the slot has room for.
    pub room: u32,
}

impl BootStatus {
    /// The bytes that the device sends.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; STATUS_LENGTH] {
        let flags = u8::from(self.confirmed)
            | u8::from(self.key_installed) << 1
            | u8::from(self.has_fallback) << 2;
        let [a0, a1] = self.application.to_le_bytes();
        let [f0, f1] = self.fallback.to_le_bytes();
        let first = [
            STATUS_FORMAT,
            self.reason as u8,
            flags,
            self.trial_failures,
            a0,
            a1,
            f0,
            f1,
        ];
        let mut bytes = [0; STATUS_LENGTH];
        let words = [
            u32::from_le_bytes([first[0], first[1], first[2], first[3]]),
            u32::from_le_bytes([first[4], first[5], first[6], first[7]]),
            self.rollback,
            self.stored,
            self.wanted,
            self.product,
            self.hardware,
            self.room,
        ];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(&words) {
            *place = word.to_le_bytes();
        }
        bytes
    }

    /// Reads the bytes; `None` if they are too few or of another format. Bytes that a later version appends
    /// are ignored.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.first_chunk::<STATUS_LENGTH>()?;
        let [
            STATUS_FORMAT,
            reason,
            flags,
            trial_failures,
            a0,
            a1,
            f0,
            f1,
            ..,
        ] = *bytes
        else {
            return None;
        };
        let word = |index: usize| {
            let at = 8 + 4 * index;
            let bytes: Option<[u8; 4]> = bytes
                .get(at..at + 4)
                .and_then(|bytes| bytes.try_into().ok());
            bytes.map_or(0, u32::from_le_bytes)
        };
        Some(Self {
            reason: Reason::from_code(reason)?,
            confirmed: flags & 1 != 0,
            key_installed: flags & 2 != 0,
            has_fallback: flags & 4 != 0,
            trial_failures,
            application: u16::from_le_bytes([a0, a1]),
            fallback: u16::from_le_bytes([f0, f1]),
            rollback: word(0),
            stored: word(1),
            wanted: word(2),
            product: word(3),
            hardware: word(4),
            room: word(5),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_reads_back_as_it_is_written() {
        for (reason, _) in Reason::TABLE {
            let status = BootStatus {
                reason,
                confirmed: true,
                key_installed: false,
                has_fallback: true,
                trial_failures: 2,
                application: 0x0117,
                fallback: 0xFFFF,
                rollback: 9,
                stored: 0x4000_0001,
                wanted: 0x4000_0003,
                product: 0x6020_0103,
                hardware: 0x405,
                room: 0x7FFF_FFFF,
            };
            let bytes = status.to_bytes();
            assert_eq!(bytes[..8], [1, reason as u8, 5, 2, 0x17, 1, 0xFF, 0xFF]);
            assert_eq!(bytes[8..16], [9, 0, 0, 0, 1, 0, 0, 0x40]);
            assert_eq!(BootStatus::from_bytes(&bytes), Some(status));
            assert_eq!(BootStatus::from_bytes(&bytes[..31]), None);
        }
        assert_eq!(BootStatus::from_bytes(&[2; STATUS_LENGTH]), None);
    }
}
