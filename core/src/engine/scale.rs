//! The one place where a 64-bit product becomes 32 bits again.

/// `sum` / 2^`SHIFT`, towards minus infinity, saturated to 32 bits; `SHIFT` is 1 to 31.
///
/// Constant shifts and one comparison: a quarter of what a clamp of 64 bits costs on a Cortex-M4.
#[inline]
pub(super) const fn scaled<const SHIFT: u32>(sum: i64) -> i32 {
    let shifted = (sum >> SHIFT) as i32;
    let high = (sum >> 32) as i32;
    // It fits if what the result takes of the upper half is a signed number of SHIFT bits.
    let half = 1 << (SHIFT - 1);
    if (high.wrapping_add(half) as u32) < 2 * half as u32 {
        shifted
    } else {
        (high >> 31) ^ i32::MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn clamped(sum: i64, shift: u32) -> i32 {
        (sum >> shift).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    proptest! {
        #[test]
        fn a_scaled_sum_is_the_clamped_one(sum: i64, bits in 0..63_u32) {
            // Sums of every size, and the ends of what fits with their neighbours.
            let ends = [15, 16, 22].map(|shift| i64::from(i32::MAX) << shift);
            for sum in ends.into_iter().flat_map(|end| [end, -end, end + (1 << 22), -end - (1 << 22)])
                .chain([sum >> bits]) {
                prop_assert_eq!(scaled::<1>(sum), clamped(sum, 1));
                prop_assert_eq!(scaled::<15>(sum), clamped(sum, 15));
                prop_assert_eq!(scaled::<16>(sum), clamped(sum, 16));
                prop_assert_eq!(scaled::<22>(sum), clamped(sum, 22));
                prop_assert_eq!(scaled::<31>(sum), clamped(sum, 31));
            }
        }
    }
}
