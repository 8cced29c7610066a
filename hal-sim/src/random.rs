//! Seeded random numbers: the only source of chance on the bench.

/// SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014): one
/// addition and two multiplications a number, any seed is a good one, and the sequence is the same on
/// every machine. Not for secrets.
#[derive(Clone, Debug)]
pub(crate) struct Random {
    state: u64,
}

impl Random {
    /// A generator whose sequence depends on `seed` and `stream` only, so that each part of a world
    /// draws from a sequence of its own and adding a part does not disturb the others.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        let mut random = Self {
            state: seed ^ stream.wrapping_mul(0xD134_2543_DE82_EF95),
        };
        random.next();
        random
    }

    /// The next 64 random bits.
    pub(crate) fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// True with this probability; 0 or less never draws a number.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        const PER_STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        probability > 0.0 && ((self.next() >> 11) as f64) * PER_STEP < probability
    }

    /// A number from 0 to `bound` − 1; 0 for a bound of 0.
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        // The high half of the product is uniform up to 2^-64 times the bound, which no test can see.
        ((u128::from(self.next()) * u128::from(bound)) >> 64) as u64
    }

    /// Bell-shaped noise of mean 0 and standard deviation 1: the sum of four uniform bytes, which
    /// needs no logarithm (whose last bit differs between mathematics libraries). Never beyond ±3.5.
    pub(crate) fn bell(&mut self) -> f64 {
        const MEAN: i32 = 2 * 255;
        // Variance of a uniform byte is (256² − 1) / 12; four of them give 21845, the root 147.80.
        const PER_UNIT: f64 = 1.0 / 147.8;
        let bytes = self.next().to_le_bytes();
        let sum: i32 = bytes[..4].iter().map(|byte| i32::from(*byte)).sum();
        f64::from(sum - MEAN) * PER_UNIT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let draw = |seed, stream| Random::new(seed, stream).next();
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }

    #[test]
    fn chance_follows_its_probability() {
        let mut random = Random::new(7, 0);
        let hits = (0..100_000).filter(|_| random.chance(0.25)).count();
        assert!((24_500..25_500).contains(&hits), "{hits}");
        assert!(!random.chance(0.0));
        assert!(random.chance(1.0));
    }

    #[test]
    fn bell_noise_has_unit_deviation() {
        let mut random = Random::new(7, 1);
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..100_000 {
            let value = random.bell();
            sum += value;
            squares += value * value;
        }
        assert!((sum / 1e5).abs() < 0.02);
        assert!((squares / 1e5 - 1.0).abs() < 0.02);
    }
}
