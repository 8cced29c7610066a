//! A classic CAN frame as a plain value.

use embedded_can::{ExtendedId, Id, StandardId};

/// A classic CAN 2.0 data or remote frame.
///
/// Invariant: `len` is at most 8 and the data bytes beyond it are zero, so that codecs can read
/// fixed positions and two equal frames compare equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: Id,
    data: [u8; 8],
    len: u8,
    remote: bool,
}

impl Frame {
    /// A data frame; `None` if `data` is longer than 8 bytes.
    #[must_use]
    pub fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 8];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self {
            id: id.into(),
            data: bytes,
            len: data.len() as u8,
            remote: false,
        })
    }

    /// A remote frame; `None` if `dlc` is above 8.
    #[must_use]
    pub fn remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        (dlc <= 8).then(|| Self {
            id: id.into(),
            data: [0; 8],
            len: dlc as u8,
            remote: true,
        })
    }

    /// A data frame with a 29-bit identifier and exactly `N` bytes. Identifier bits above the 29th are
    /// dropped and bytes above the eighth do not compile.
    #[must_use]
    pub const fn extended<const N: usize>(raw_id: u32, data: [u8; N]) -> Self {
        const { assert!(N <= 8) };
        let id = match ExtendedId::new(raw_id & 0x1FFF_FFFF) {
            Some(id) => id,
            None => ExtendedId::ZERO,
        };
        Self {
            id: Id::Extended(id),
            data: widen(data),
            len: N as u8,
            remote: false,
        }
    }

    /// A data frame with an 11-bit identifier and exactly `N` bytes; see [`Frame::extended`].
    #[must_use]
    pub const fn standard<const N: usize>(raw_id: u16, data: [u8; N]) -> Self {
        const { assert!(N <= 8) };
        let id = match StandardId::new(raw_id & 0x7FF) {
            Some(id) => id,
            None => StandardId::ZERO,
        };
        Self {
            id: Id::Standard(id),
            data: widen(data),
            len: N as u8,
            remote: false,
        }
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
    pub const fn id(&self) -> Id {
        self.id
    }

    /// The 29-bit identifier; `None` for an 11-bit frame.
    #[must_use]
    pub fn extended_id(&self) -> Option<u32> {
        match self.id {
            Id::Extended(id) => Some(id.as_raw()),
            Id::Standard(_) => None,
        }
    }

    /// The identifier without its width.
    #[must_use]
    pub fn raw_id(&self) -> u32 {
        match self.id {
            Id::Extended(id) => id.as_raw(),
            Id::Standard(id) => u32::from(id.as_raw()),
        }
    }

    /// True for a 29-bit identifier.
    #[must_use]
    pub const fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    /// True for a remote transmission request.
    #[must_use]
    pub const fn is_remote(&self) -> bool {
        self.remote
    }

    /// Data length code, 0 to 8.
    #[must_use]
    pub const fn dlc(&self) -> usize {
        self.len as usize
    }

    /// The data bytes: as many as the data length code says, none for a remote frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        let len = if self.remote {
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

    /// The data bytes if this is a data frame of exactly `N` bytes: the one length gate of every codec.
    #[must_use]
    pub fn exact<const N: usize>(&self) -> Option<&[u8; N]> {
        if self.remote || usize::from(self.len) != N {
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
        self.remote
    }

    fn id(&self) -> Id {
        self.id
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
