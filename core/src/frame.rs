//! A classic CAN frame as a plain value.

use embedded_can::{ExtendedId, Id, StandardId};

/// Bit of [`Frame`]'s identifier word: the identifier has 29 bits.
const EXTENDED: u32 = 1 << 31;
/// Bit of [`Frame`]'s identifier word: a remote frame.
const REMOTE: u32 = 1 << 30;
/// Largest 29-bit identifier.
const EXTENDED_MAX: u32 = 0x1FFF_FFFF;
/// Largest 11-bit identifier.
const STANDARD_MAX: u16 = 0x7FF;

/// A 29-bit identifier in the form in which [`Frame::is`] compares it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExtendedMatch(u32);

impl ExtendedMatch {
    /// No frame has this one.
    pub const NONE: Self = Self(REMOTE);

    /// This identifier; bits above the 29th are dropped.
    #[must_use]
    pub const fn new(raw_id: u32) -> Self {
        Self(raw_id & EXTENDED_MAX | EXTENDED)
    }
}

/// A classic CAN 2.0 data or remote frame.
///
/// Invariant: `len` is at most 8 and the data bytes beyond it are zero, so that codecs can read
/// fixed positions and two equal frames compare equal. The identifier and its two flags share one word, so
/// that a controller on a busy bus tells a foreign frame with one comparison.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    word: u32,
    data: [u8; 8],
    len: u8,
}

impl core::fmt::Debug for Frame {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Frame")
            .field("id", &self.id())
            .field("data", &self.data)
            .field("len", &self.len)
            .field("remote", &self.is_remote())
            .finish()
    }
}

/// The identifier word of a data frame.
fn word(id: Id) -> u32 {
    match id {
        Id::Extended(id) => id.as_raw() | EXTENDED,
        Id::Standard(id) => u32::from(id.as_raw()),
    }
}

impl Frame {
    /// A data frame; `None` if `data` is longer than 8 bytes.
    #[must_use]
    pub fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 8];
        if data.len() > bytes.len() {
            return None;
        }
        // Byte by byte: the copy of a slice checks the length once more, which is a panic path where it is not
        // inlined.
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = *from;
        }
        Some(Self {
            word: word(id.into()),
            data: bytes,
            len: data.len() as u8,
        })
    }

    /// A remote frame; `None` if `dlc` is above 8.
    #[must_use]
    pub fn remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        (dlc <= 8).then(|| Self {
            word: word(id.into()) | REMOTE,
            data: [0; 8],
            len: dlc as u8,
        })
    }

    /// A data frame with a 29-bit identifier and exactly `N` bytes. Identifier bits above the 29th are
    /// dropped and bytes above the eighth do not compile.
    #[must_use]
    pub const fn extended<const N: usize>(raw_id: u32, data: [u8; N]) -> Self {
        const { assert!(N <= 8) };
        Self {
            word: raw_id & EXTENDED_MAX | EXTENDED,
            data: widen(data),
            len: N as u8,
        }
    }

    /// A data frame with an 11-bit identifier and exactly `N` bytes; see [`Frame::extended`].
    #[must_use]
    pub const fn standard<const N: usize>(raw_id: u16, data: [u8; N]) -> Self {
        const { assert!(N <= 8) };
        Self {
            word: (raw_id & STANDARD_MAX) as u32,
            data: widen(data),
            len: N as u8,
        }
    }

    /// The same frame with another 29-bit identifier; bits above the 29th are dropped.
    #[must_use]
    pub const fn with_extended_id(mut self, raw_id: u32) -> Self {
        self.word = self.word & REMOTE | EXTENDED | raw_id & EXTENDED_MAX;
        self
    }

    /// The same frame with only its first `len` data bytes; a longer `len` changes nothing.
    #[must_use]
    pub fn shortened(mut self, len: usize) -> Self {
        if len < usize::from(self.len) {
            self.len = len as u8;
            for byte in self.data.iter_mut().skip(len) {
                *byte = 0;
            }
        }
        self
    }

    /// The identifier with its width.
    #[must_use]
    pub fn id(&self) -> Id {
        // The masks keep both conversions within range, so the zeros only stand in for a panic.
        if self.is_extended() {
            ExtendedId::new(self.word & EXTENDED_MAX)
                .unwrap_or(ExtendedId::ZERO)
                .into()
        } else {
            StandardId::new(self.word as u16 & STANDARD_MAX)
                .unwrap_or(StandardId::ZERO)
                .into()
        }
    }

    /// The 29-bit identifier; `None` for an 11-bit frame.
    #[must_use]
    pub fn extended_id(&self) -> Option<u32> {
        self.is_extended().then_some(self.word & EXTENDED_MAX)
    }

    /// True for a data or remote frame with this identifier: one comparison.
    #[must_use]
    pub const fn is(&self, id: ExtendedMatch) -> bool {
        self.word & !REMOTE == id.0
    }

    /// True for a data or remote frame with this identifier, whatever these bits of it are.
    #[must_use]
    pub const fn is_but_for(&self, bits: u32, id: ExtendedMatch) -> bool {
        self.word & !(REMOTE | bits) == id.0
    }

    /// The identifier without its width.
    #[must_use]
    pub const fn raw_id(&self) -> u32 {
        self.word & EXTENDED_MAX
    }

    /// True for a 29-bit identifier.
    #[must_use]
    pub const fn is_extended(&self) -> bool {
        self.word & EXTENDED != 0
    }

    /// True for a remote transmission request.
    #[must_use]
    pub const fn is_remote(&self) -> bool {
        self.word & REMOTE != 0
    }

    /// Data length code, 0 to 8.
    #[must_use]
    pub const fn dlc(&self) -> usize {
        self.len as usize
    }

    /// The data bytes: as many as the data length code says, none for a remote frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        let len = if self.is_remote() {
            0
        } else {
            usize::from(self.len)
        };
        self.data.get(..len).unwrap_or(&[])
    }

    /// All eight data positions, those beyond the data length code being zero.
    #[must_use]
    pub const fn bytes(&self) -> &[u8; 8] {
        &self.data
    }

    /// The data if this is a data frame of exactly 8 bytes, as its two halves with the first byte lowest. A
    /// processor shifts a field out of a word with one instruction, and has no second byte to load.
    #[must_use]
    #[inline]
    pub fn words(&self) -> Option<[u32; 2]> {
        let [a, b, c, d, e, f, g, h] = *self.exact::<8>()?;
        Some([
            u32::from_le_bytes([a, b, c, d]),
            u32::from_le_bytes([e, f, g, h]),
        ])
    }

    /// The data bytes if this is a data frame of exactly `N` bytes: the one length gate of every codec.
    #[must_use]
    pub fn exact<const N: usize>(&self) -> Option<&[u8; N]> {
        if self.is_remote() || usize::from(self.len) != N {
            return None;
        }
        self.data.first_chunk::<N>()
    }
}

// An index out of bounds would be a compile error where the frame is constant, and `N` is at most 8.
#[allow(clippy::indexing_slicing)]
const fn widen<const N: usize>(data: [u8; N]) -> [u8; 8] {
    let mut bytes = [0; 8];
    let mut at = 0;
    while at < N && at < 8 {
        bytes[at] = data[at];
        at += 1;
    }
    bytes
}

impl embedded_can::Frame for Frame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        Self::new(id, data)
    }

    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        Self::remote(id, dlc)
    }

    fn is_extended(&self) -> bool {
        self.is_extended()
    }

    fn is_remote_frame(&self) -> bool {
        self.is_remote()
    }

    fn id(&self) -> Id {
        self.id()
    }

    fn dlc(&self) -> usize {
        self.dlc()
    }

    fn data(&self) -> &[u8] {
        self.data()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_beyond_the_length_is_zero() {
        let frame = Frame::extended(0x0206_0000, [1, 2, 3, 4, 5, 6, 7, 8]).shortened(3);
        assert_eq!(frame.data(), [1, 2, 3]);
        assert_eq!(frame.bytes(), &[1, 2, 3, 0, 0, 0, 0, 0]);
        assert_eq!(frame, Frame::extended(0x0206_0000, [1, 2, 3]));
    }

    #[test]
    fn nine_bytes_are_refused() {
        assert!(Frame::new(ExtendedId::ZERO, &[0; 9]).is_none());
        assert!(Frame::remote(ExtendedId::ZERO, 9).is_none());
    }

    #[test]
    fn the_length_gate_refuses_remote_frames() {
        let remote = Frame::remote(ExtendedId::ZERO, 8).unwrap();
        assert!(remote.exact::<8>().is_none());
        assert!(remote.data().is_empty());
    }
}
