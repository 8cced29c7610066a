//! A frame as bits on the wire: arbitration order, CRC-15, stuff bits, length (ISO 11898-1:2015,
//! clauses 10.4 and 10.5).

use embedded_can::Id;
use windlass_core::frame::Frame;

/// Bits after the CRC sequence: CRC delimiter, ACK slot, ACK delimiter, seven bits end of frame.
pub(crate) const TRAILER: u64 = 10;
/// Of the trailer, the bits up to and with the ACK slot.
pub(crate) const UP_TO_ACK: u64 = 2;
/// Recessive bits between frames.
pub(crate) const INTERMISSION: u64 = 3;
/// Width of the CRC sequence.
const CRC_BITS: u32 = 15;
/// x¹⁵ + x¹⁴ + x¹⁰ + x⁸ + x⁷ + x⁴ + x³ + 1 without the leading term.
const CRC_POLYNOMIAL: u16 = 0x4599;

/// What the bus needs to know about a frame, computed once however often it is tried.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// The arbitration field as one number: the lowest wins. 32 bits in the order of the wire: base
    /// identifier (11), RTR or SRR, IDE, extension (18), RTR.
    pub(crate) key: u32,
    /// Bits from start of frame to the end of the CRC sequence, stuff bits included.
    pub(crate) stuffed: u64,
}

impl Shape {
    /// The shape of a frame.
    pub(crate) fn of(frame: &Frame) -> Self {
        let bits = Bits::of(frame);
        Self {
            key: arbitration_key(frame),
            stuffed: u64::from(bits.len) + u64::from(bits.stuff_bits()),
        }
    }
}

/// Bits from start of frame to the last bit of end of frame.
pub(crate) fn frame_bits(shape: Shape) -> u64 {
    shape.stuffed + TRAILER
}

/// Bit times for which a frame occupies the bus, with its stuff bits and the gap of three bits after it.
#[must_use]
pub fn occupied_bits(frame: &Frame) -> u64 {
    frame_bits(Shape::of(frame)) + INTERMISSION
}

/// The arbitration field as one number that orders frames as the bus does, see [`Shape::key`].
pub(crate) fn arbitration_key(frame: &Frame) -> u32 {
    let remote = u32::from(frame.is_remote());
    match frame.id() {
        // The zeros of IDE and of what follows are dominant: a data frame with an 11-bit identifier
        // beats the remote frame and every 29-bit frame with the same base.
        Id::Standard(id) => u32::from(id.as_raw()) << 21 | remote << 20,
        Id::Extended(id) => {
            let base = id.as_raw() >> 18;
            let extension = id.as_raw() & 0x3_FFFF;
            base << 21 | 0b11 << 19 | extension << 1 | remote
        }
    }
}

/// The unstuffed bits from start of frame to the end of the CRC sequence, right-aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bits {
    bits: u128,
    len: u32,
}

impl Bits {
    /// The bits of a frame. At most 118, so they fit one number.
    pub(crate) fn of(frame: &Frame) -> Self {
        let mut stream = Self { bits: 0, len: 0 };
        stream.push(0, 1);
        let remote = u64::from(frame.is_remote());
        match frame.id() {
            Id::Standard(id) => {
                stream.push(u64::from(id.as_raw()), 11);
                // RTR, IDE dominant, reserved bit dominant.
                stream.push(remote << 2, 3);
            }
            Id::Extended(id) => {
                stream.push(u64::from(id.as_raw() >> 18), 11);
                stream.push(0b11, 2);
                stream.push(u64::from(id.as_raw() & 0x3_FFFF), 18);
                stream.push(remote << 2, 3);
            }
        }
        stream.push(frame.dlc() as u64, 4);
        for byte in frame.data() {
            stream.push(u64::from(*byte), 8);
        }
        let crc = stream.crc();
        stream.push(u64::from(crc), CRC_BITS);
        stream
    }

    fn push(&mut self, value: u64, width: u32) {
        self.bits = self.bits << width | u128::from(value);
        self.len += width;
    }

    /// CRC-15 of the bits so far. The zeros that pad the number to whole bytes come first, where they
    /// leave a checksum that starts from 0 unchanged.
    fn crc(self) -> u16 {
        let mut crc = 0_u16;
        for index in (0..self.len.div_ceil(8)).rev() {
            let byte = (self.bits >> (8 * index)) as u8;
            let row = (crc >> 7) as u8 ^ byte;
            crc = (crc << 8 ^ CRC_TABLE[usize::from(row)]) & 0x7FFF;
        }
        crc
    }

    /// Number of stuff bits.
    fn stuff_bits(self) -> u32 {
        self.stuff_bits_of_first(self.len)
    }

    /// Number of stuff bits among and right after the first `count` bits.
    fn stuff_bits_of_first(self, count: u32) -> u32 {
        // The start of frame is one dominant bit; the rest is walked in whole bytes after the odd bits.
        let mut left = count.saturating_sub(1);
        let mut state = StuffState {
            last: false,
            run: 1,
        };
        let mut total = 0;
        while !left.is_multiple_of(8) {
            total += u32::from(state.feed(self.bit(self.len - count + left - 1)));
            left -= 1;
        }
        let mut index = state.index();
        while left > 0 {
            left -= 8;
            let byte = (self.bits >> (self.len - count + left)) as u8;
            let entry = STUFF_TABLE[index][usize::from(byte)];
            total += u32::from(entry >> 4);
            index = usize::from(entry & 0x0F);
        }
        total
    }

    /// The bit `position` places from the end.
    fn bit(self, position: u32) -> bool {
        self.bits >> position & 1 == 1
    }

    /// Bits on the wire, stuff bits included, up to and with the first bit in which two frames differ;
    /// `None` if they are the same frame.
    pub(crate) fn stuffed_until_difference(self, other: Self) -> Option<u64> {
        if self == other {
            return None;
        }
        let left = self.bits << (128 - self.len);
        let right = other.bits << (128 - other.len);
        let first = (left ^ right).leading_zeros().min(self.len - 1);
        Some(u64::from(first + 1 + self.stuff_bits_of_first(first)))
    }
}

/// Run length of equal bits while stuffing.
#[derive(Clone, Copy)]
struct StuffState {
    last: bool,
    /// 1 to 4: a fifth equal bit is followed by its opposite, which starts a new run.
    run: u8,
}

impl StuffState {
    /// Takes one bit; true if a stuff bit follows it.
    const fn feed(&mut self, bit: bool) -> bool {
        if bit != self.last {
            self.last = bit;
            self.run = 1;
            return false;
        }
        self.run += 1;
        if self.run < 5 {
            return false;
        }
        self.last = !bit;
        self.run = 1;
        true
    }

    const fn index(self) -> usize {
        (self.run as usize - 1) * 2 + self.last as usize
    }

    const fn from_index(index: usize) -> Self {
        Self {
            last: index & 1 == 1,
            run: (index / 2) as u8 + 1,
        }
    }
}

/// For each state and each next byte: number of stuff bits in the high half, next state in the low.
static STUFF_TABLE: [[u8; 256]; 8] = stuff_table();

const fn stuff_table() -> [[u8; 256]; 8] {
    let mut table = [[0; 256]; 8];
    let mut index = 0;
    while index < 8 {
        let mut byte = 0;
        while byte < 256 {
            let mut state = StuffState::from_index(index);
            let mut count = 0;
            let mut bit = 8;
            while bit > 0 {
                bit -= 1;
                count += state.feed(byte >> bit & 1 == 1) as u8;
            }
            table[index][byte] = count << 4 | state.index() as u8;
            byte += 1;
        }
        index += 1;
    }
    table
}

static CRC_TABLE: [u16; 256] = crc_table();

const fn crc_table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u16) << 7;
        let mut bit = 0;
        while bit < 8 {
            let carry = crc & 0x4000 != 0;
            crc = (crc << 1) & 0x7FFF;
            if carry {
                crc ^= CRC_POLYNOMIAL;
            }
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, StandardId};
    use proptest::prelude::*;

    /// The standard's own bit-by-bit description, to check the tables against.
    fn crc_bit_by_bit(bits: impl Iterator<Item = bool>) -> u16 {
        let mut crc = 0_u16;
        for bit in bits {
            let next = bit ^ (crc & 0x4000 != 0);
            crc = crc << 1 & 0x7FFF;
            if next {
                crc ^= CRC_POLYNOMIAL;
            }
        }
        crc
    }

    fn stuffed_bit_by_bit(bits: Bits) -> Vec<bool> {
        let mut out: Vec<bool> = Vec::new();
        for position in (0..bits.len).rev() {
            out.push(bits.bit(position));
            if out.len() >= 5 {
                let tail = &out[out.len() - 5..];
                if tail.iter().all(|bit| *bit == tail[0]) {
                    let opposite = !tail[0];
                    out.push(opposite);
                }
            }
        }
        out
    }

    fn destuffed(stuffed: &[bool]) -> Vec<bool> {
        let mut out = Vec::new();
        let mut run = 0;
        let mut last = None;
        let mut skip = false;
        for &bit in stuffed {
            run = if last == Some(bit) { run + 1 } else { 1 };
            last = Some(bit);
            if !skip {
                out.push(bit);
            }
            skip = run == 5;
        }
        out
    }

    #[test]
    fn crc_has_the_catalogued_check_value() {
        // CRC-15/CAN in the catalogue of parametrised CRC algorithms: check 0x059E over "123456789".
        let bits = b"123456789"
            .iter()
            .flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1 == 1));
        assert_eq!(crc_bit_by_bit(bits), 0x059E);
    }

    #[test]
    fn unstuffed_lengths_are_the_standards() {
        // 44 + 8n and 64 + 8n bits with the trailer, without stuff bits and intermission.
        let standard = Frame::standard(0x123, [0; 8]);
        let extended = Frame::extended(0x0206_0000, [0; 8]);
        assert_eq!(u64::from(Bits::of(&standard).len) + TRAILER, 44 + 64);
        assert_eq!(u64::from(Bits::of(&extended).len) + TRAILER, 64 + 64);
    }

    #[test]
    fn a_frame_of_zeros_is_stuffed_after_every_fifth_bit() {
        // Identifier 0, no data: 34 dominant bits (the CRC of zeros is zero), so 6 stuff bits.
        let shape = Shape::of(&Frame::standard(0, []));
        assert_eq!(shape.stuffed, 34 + 6);
        assert_eq!(frame_bits(shape), 50);
        // With a 29-bit identifier: 12 dominant bits, SRR and IDE recessive, 25 dominant bits, CRC.
        let bits = Bits::of(&Frame::extended(0, []));
        assert_eq!(
            u32::try_from(stuffed_bit_by_bit(bits).len()).unwrap(),
            bits.len + bits.stuff_bits()
        );
    }

    #[test]
    fn fields_are_in_the_order_of_the_wire() {
        // Start of frame, identifier 0x014, RTR, IDE, r0, length 1, byte 0x01.
        let bits = Bits::of(&Frame::standard(0x14, [0x01]));
        let head = bits.bits >> CRC_BITS;
        let fields = [(0, 1), (0x014, 11), (0b000, 3), (1, 4), (0x01, 8)];
        let expected = fields
            .iter()
            .fold(0, |bits, (value, width)| bits << width | value);
        assert_eq!(head, expected);
        let unstuffed = (0..27).rev().map(|bit| head >> bit & 1 == 1);
        assert_eq!((bits.bits & 0x7FFF) as u16, crc_bit_by_bit(unstuffed));
    }

    #[test]
    fn the_lower_arbitration_field_wins() {
        let standard = |id| StandardId::new(id).unwrap();
        let extended = |id| ExtendedId::new(id).unwrap();
        let order = [
            Frame::new(standard(0x080), &[]).unwrap(),
            Frame::remote(standard(0x080), 0).unwrap(),
            Frame::new(extended(0x080 << 18), &[]).unwrap(),
            Frame::remote(extended(0x080 << 18), 0).unwrap(),
            Frame::new(extended((0x080 << 18) + 1), &[]).unwrap(),
            Frame::new(standard(0x081), &[]).unwrap(),
            Frame::new(extended(0x1FFF_FFFF), &[]).unwrap(),
        ];
        for pair in order.windows(2) {
            let (first, second) = (arbitration_key(&pair[0]), arbitration_key(&pair[1]));
            assert!(first < second, "{pair:?}");
        }
    }

    #[test]
    fn the_first_difference_is_found_after_its_stuff_bits() {
        let left = Bits::of(&Frame::standard(0x7FF, [0x00]));
        let right = Bits::of(&Frame::standard(0x7FF, [0x80]));
        // SOF and 11 recessive bits (2 stuff bits), RTR, IDE, r0, DLC 0001 (six dominant bits, 1 stuff
        // bit): 19 bits, then the first data bit.
        assert_eq!(left.stuffed_until_difference(right), Some(20 + 3));
        assert_eq!(left.stuffed_until_difference(left), None);
    }

    proptest! {
        #[test]
        fn tables_agree_with_the_bit_by_bit_description(
            extended: bool, id in 0_u32..0x2000_0000, data in proptest::collection::vec(any::<u8>(), 0..=8)
        ) {
            let frame = if extended {
                Frame::new(ExtendedId::new(id).unwrap(), &data).unwrap()
            } else {
                Frame::new(StandardId::new((id & 0x7FF) as u16).unwrap(), &data).unwrap()
            };
            let bits = Bits::of(&frame);
            let stuffed = stuffed_bit_by_bit(bits);
            prop_assert_eq!(bits.len + bits.stuff_bits(), stuffed.len() as u32);
            let plain = destuffed(&stuffed);
            prop_assert_eq!(plain.len() as u32, bits.len);
            let body = plain[..plain.len() - 15].iter().copied();
            prop_assert_eq!(crc_bit_by_bit(body), (bits.bits & 0x7FFF) as u16);
            // Five stuff-able bits make at most one stuff bit, later runs need four.
            prop_assert!(bits.stuff_bits() <= (bits.len - 1) / 4);
        }
    }
}
