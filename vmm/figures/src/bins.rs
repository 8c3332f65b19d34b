//! How often each value occurred.
//!
//! A bin of 32 bits holds a count of 4,294,967,295: 49.7 days of a cycle of 1 ms. A full one counts no
//! further, and percentiles come out wrong. Bins of 64 bits never get full, but take twice the memory.
//! So there are those of 32 bits until one could be full.

use hdrhistogram::{Counter, Histogram};

/// Digits that a value keeps.
const SIGNIFICANT_DIGITS: u8 = 3;

/// Counts of values; those that are too close to be kept apart share one.
pub enum Bins {
    Narrow(Histogram<u32>),
    Wide(Histogram<u64>),
}

impl Bins {
    pub fn new() -> Option<Self> {
        Histogram::new(SIGNIFICANT_DIGITS).ok().map(Self::Narrow)
    }

    pub fn record(&mut self, value: u64) {
        // Grows as needed; only a value beyond 2^63 would be refused.
        let _ = match self {
            Self::Narrow(bins) if bins.len() < u64::from(u32::MAX) => bins.record(value),
            Self::Narrow(bins) => {
                let mut wide = wide(bins);
                let recorded = wide.record(value);
                *self = Self::Wide(wide);
                recorded
            }
            Self::Wide(bins) => bins.record(value),
        };
    }

    /// A part of the values is at most this.
    pub fn value_at_quantile(&self, part: f64) -> u64 {
        match self {
            Self::Narrow(bins) => bins.value_at_quantile(part),
            Self::Wide(bins) => bins.value_at_quantile(part),
        }
    }

    /// All values, in rising order, and how often each occurred. Of values that share a bin it is the
    /// greatest possible.
    pub fn counts(&self) -> Vec<(u64, u64)> {
        match self {
            Self::Narrow(bins) => counts(bins),
            Self::Wide(bins) => counts(bins),
        }
    }
}

fn counts<C: Counter>(bins: &Histogram<C>) -> Vec<(u64, u64)> {
    let recorded = bins.iter_recorded();
    recorded.map(|v| (v.value_iterated_to(), v.count_since_last_iteration())).collect()
}

fn wide(narrow: &Histogram<u32>) -> Histogram<u64> {
    let mut wide = Histogram::new_from(narrow);
    for (value, count) in counts(narrow) {
        // The source has room for it, so this has too.
        let _ = wide.record_n(value, count);
    }
    wide
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As after 49.7 days at 1 kHz: all but two of the values that 32 bits can count, and those of other bins.
    fn nearly_full() -> Bins {
        let mut bins = Histogram::new(SIGNIFICANT_DIGITS).unwrap();
        bins.record_n(9_001, u32::MAX - 2).unwrap();
        bins.record_n(700, 1).unwrap();
        Bins::Narrow(bins)
    }

    #[test]
    fn more_values_than_32_bits_can_count_keep_their_counts_and_percentiles() {
        let mut bins = nearly_full();
        let days = u64::from(u32::MAX);
        for seen in 1..=5 {
            bins.record(9_001);
            assert_eq!(bins.counts(), [(700, 1), (9_007, days - 2 + seen)]);
            for part in [0.5, 0.99, 0.999, 1.0] {
                assert_eq!(bins.value_at_quantile(part), 9_007, "{part} after {seen}");
            }
        }
        assert!(matches!(bins, Bins::Wide(_)));
        bins.record(1 << 40);
        assert_eq!(bins.counts().last().map(|(_, count)| *count), Some(1));
    }
}
