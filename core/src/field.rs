//! Total readers and writers for the fields of a frame: every input has a result, none panics.

/// Bit `bit` (0 = least significant) of `byte`.
#[must_use]
pub const fn bit(byte: u8, bit: u8) -> bool {
    (byte >> (bit & 7)) & 1 != 0
}

/// A byte with bit `bit` set where `value` is true; combine several with `|`.
#[must_use]
pub const fn flag(value: bool, bit: u8) -> u8 {
    (value as u8) << (bit & 7)
}

/// A signed 24-bit number from its bytes, high byte first.
#[must_use]
pub const fn i24(high: u8, middle: u8, low: u8) -> i32 {
    i32::from_be_bytes([high, middle, low, 0]) >> 8
}

/// Largest signed 24-bit number.
pub const I24_MAX: i32 = 0x7F_FFFF;
/// Smallest signed 24-bit number.
pub const I24_MIN: i32 = -0x80_0000;

/// The bytes of a signed 24-bit number, high byte first, saturated.
#[must_use]
pub const fn i24_bytes(value: i32) -> [u8; 3] {
    let [_, high, middle, low] = saturate(value, I24_MIN, I24_MAX).to_be_bytes();
    [high, middle, low]
}

/// `value` moved into `min..=max`.
#[must_use]
pub const fn saturate(value: i32, min: i32, max: i32) -> i32 {
    if value < min {
        min
    } else if value > max {
        max
    } else {
        value
    }
}

/// `value` saturated to 16 bits.
#[must_use]
pub const fn saturate_i16(value: i32) -> i16 {
    saturate(value, i16::MIN as i32, i16::MAX as i32) as i16
}

/// A number for a field that is too narrow for it: divided by 2^`shift` (rounded down, sign kept) if it
/// lies outside `min..=max`, then saturated. The flag tells whether it was divided.
#[must_use]
pub const fn divide_on_overflow(value: i32, min: i32, max: i32, shift: u32) -> (i32, bool) {
    if value >= min && value <= max {
        (value, false)
    } else {
        (saturate(value >> shift, min, max), true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn i24_keeps_its_sign_and_saturates() {
        for value in [0, 1, -1, I24_MAX, I24_MIN] {
            let [high, middle, low] = i24_bytes(value);
            assert_eq!(i24(high, middle, low), value);
        }
        assert_eq!(i24_bytes(i32::MAX), [0x7F, 0xFF, 0xFF]);
        assert_eq!(i24_bytes(i32::MIN), [0x80, 0, 0]);
    }

    #[test]
    fn only_an_overflow_is_divided() {
        assert_eq!(divide_on_overflow(32767, -32768, 32767, 2), (32767, false));
        assert_eq!(divide_on_overflow(32768, -32768, 32767, 2), (8192, true));
        assert_eq!(divide_on_overflow(-32769, -32768, 32767, 2), (-8193, true));
        assert_eq!(divide_on_overflow(1 << 30, -32768, 32767, 2), (32767, true));
    }
}
