//! CRC-32 with the polynomial 0x04C11DB7, bit-reflected: what images, records and page transfers are
//! checked by.
//!
//! Two variants are in use. CRC-32/ISO-HDLC (initial value and final xor of all ones; check value
//! 0xCBF43926) guards what is stored. The page transfer of the DMC60C starts from 0 and has no final xor
//! (check value 0x2DFD2D88; docs/dmc60c.md).

/// The polynomial 0x04C11DB7, bit-reflected.
const POLYNOMIAL: u32 = 0xEDB8_8320;

/// Remainders of the 16 values of four bits: 64 bytes of flash instead of the 1 KiB of a byte-wise table,
/// which a bootloader of 8 KiB cannot spare.
const TABLE: [u32; 16] = table();

// An index out of bounds would be a compile error: the table is constant.
#[allow(clippy::indexing_slicing)]
const fn table() -> [u32; 16] {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut remainder = nibble as u32;
        let mut bit = 0;
        while bit < 4 {
            remainder = match remainder & 1 {
                0 => remainder >> 1,
                _ => (remainder >> 1) ^ POLYNOMIAL,
            };
            bit += 1;
        }
        table[nibble] = remainder;
        nibble += 1;
    }
    table
}

// The mask keeps the index below 16.
#[allow(clippy::indexing_slicing)]
const fn step(register: u32, byte: u8) -> u32 {
    let register = register ^ byte as u32;
    let register = (register >> 4) ^ TABLE[(register & 0xF) as usize];
    (register >> 4) ^ TABLE[(register & 0xF) as usize]
}

/// A CRC that is being computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Crc32 {
    /// Nothing read yet, for [`Crc32::finish`] (CRC-32/ISO-HDLC).
    #[must_use]
    pub const fn new() -> Self {
        Self(0xFFFF_FFFF)
    }

    /// Nothing read yet, for [`Crc32::raw`] (the DMC60C's page transfer).
    #[must_use]
    pub const fn zero() -> Self {
        Self(0)
    }

    /// Takes one byte. Not inlined, like [`Crc32::update`]: each copy would take 60 bytes of machine code.
    #[inline(never)]
    pub const fn push(&mut self, byte: u8) {
        self.0 = step(self.0, byte);
    }

    /// Takes all bytes.
    // Not inlined, because it is called from everywhere. The index is below the length.
    #[allow(clippy::indexing_slicing)]
    #[inline(never)]
    pub const fn update(&mut self, bytes: &[u8]) {
        let mut at = 0;
        while at < bytes.len() {
            self.0 = step(self.0, bytes[at]);
            at += 1;
        }
    }

    /// The CRC-32/ISO-HDLC of what was taken since [`Crc32::new`].
    #[must_use]
    pub const fn finish(self) -> u32 {
        !self.0
    }

    /// The register as it is: the CRC of the page transfer since [`Crc32::zero`].
    #[must_use]
    pub const fn raw(self) -> u32 {
        self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

/// CRC-32/ISO-HDLC of some bytes.
#[must_use]
pub const fn iso_hdlc(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.update(bytes);
    crc.finish()
}

/// CRC of the DMC60C's page transfer (docs/dmc60c.md, "Updates").
#[must_use]
pub const fn page_transfer(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::zero();
    crc.update(bytes);
    crc.raw()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values() {
        assert_eq!(iso_hdlc(b"123456789"), 0xCBF4_3926);
        assert_eq!(page_transfer(b"123456789"), 0x2DFD_2D88);
    }

    #[test]
    fn page_transfer_values_of_whole_pages() {
        assert_eq!(page_transfer(&[0; 4096]), 0);
        assert_eq!(page_transfer(&[0xFF; 4096]), 0x3648_671B);
        let mut padded = [0; 4096];
        for byte in padded.iter_mut().skip(3).step_by(4) {
            *byte = 0xFF;
        }
        assert_eq!(page_transfer(&padded), 0xECDD_150B);
    }

    #[test]
    fn bytes_may_come_in_pieces() {
        let mut crc = Crc32::new();
        crc.update(b"1234");
        crc.push(b'5');
        crc.update(b"6789");
        assert_eq!(crc.finish(), 0xCBF4_3926);
    }
}
