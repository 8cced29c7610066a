//! How busy the bus was during the last 100 ms.

/// Width of one bucket in ns.
const BUCKET: u64 = 5_000_000;
/// Buckets that are looked at: 100 ms.
const BUCKETS: usize = 20;

/// Sliding measurement of the bus load in buckets of 5 ms.
#[derive(Clone, Debug, Default)]
pub(crate) struct LoadMeter {
    busy: [u64; BUCKETS],
    /// Number of the newest bucket since time zero.
    newest: u64,
}

impl LoadMeter {
    /// The bus was busy from `start` to `end` (ns); spans come in order.
    pub(crate) fn add(&mut self, start: u64, end: u64) {
        let mut from = start;
        while from < end {
            let bucket = from / BUCKET;
            let to = end.min((bucket + 1) * BUCKET);
            self.roll(bucket);
            self.busy[(bucket % BUCKETS as u64) as usize] += to - from;
            from = to;
        }
    }

    /// Load in percent during the 95 to 100 ms before `now`, or since time zero at the beginning.
    pub(crate) fn percent(&mut self, now: u64) -> f64 {
        self.roll(now / BUCKET);
        let oldest = (now / BUCKET).saturating_sub(BUCKETS as u64 - 1) * BUCKET;
        let span = now - oldest;
        if span == 0 {
            return 0.0;
        }
        // A frame under way is counted up to its end, which lies a little ahead.
        let busy = self.busy.iter().sum::<u64>().min(span);
        busy as f64 * 100.0 / span as f64
    }

    fn roll(&mut self, bucket: u64) {
        if bucket <= self.newest {
            return;
        }
        if bucket - self.newest >= BUCKETS as u64 {
            self.busy = [0; BUCKETS];
        } else {
            for passed in self.newest + 1..=bucket {
                self.busy[(passed % BUCKETS as u64) as usize] = 0;
            }
        }
        self.newest = bucket;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn load_is_the_busy_share_of_the_window() {
        let mut meter = LoadMeter::default();
        for period in 0..300 {
            meter.add(period * MS, period * MS + MS / 4);
        }
        assert!((meter.percent(300 * MS) - 25.0).abs() < 0.5);
        assert!((meter.percent(350 * MS) - 12.5).abs() < 1.5);
        assert!(meter.percent(500 * MS) < 0.01);
    }

    #[test]
    fn the_first_frames_count_against_the_time_so_far() {
        let mut meter = LoadMeter::default();
        assert!(meter.percent(0) < 0.01);
        meter.add(0, MS);
        assert!((meter.percent(2 * MS) - 50.0).abs() < 0.01);
    }
}
