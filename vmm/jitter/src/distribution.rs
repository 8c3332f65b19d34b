//! A distribution: each value, and how often it occurred.

/// Values that are drawn one by one; a plot has fewer dots.
const STEPS: usize = 2_000;

/// A distribution that is not empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Distribution {
    /// In rising order, each value once, each count at least 1.
    counts: Vec<(u64, u64)>,
    total: u64,
}

/// Values from `from` up to but not `to`, and how many there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bin {
    /// Least value.
    pub from: u64,
    /// First value beyond.
    pub to: u64,
    /// How many.
    pub count: u64,
}

impl Distribution {
    /// From values and counts in any order; `None` if there are none.
    pub fn new(counts: &[(u64, u64)]) -> Option<Self> {
        let mut counts: Vec<(u64, u64)> = counts.iter().copied().filter(|c| c.1 > 0).collect();
        counts.sort_unstable();
        counts.dedup_by(|later, kept| {
            let same = later.0 == kept.0;
            if same {
                kept.1 = kept.1.saturating_add(later.1);
            }
            same
        });
        let total = counts.iter().fold(0u64, |sum, (_, count)| sum.saturating_add(*count));
        (total > 0).then_some(Self { counts, total })
    }

    /// How many values there are.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// The least value.
    pub fn min(&self) -> u64 {
        self.counts.first().map_or(0, |(value, _)| *value)
    }

    /// The greatest value.
    pub fn max(&self) -> u64 {
        self.counts.last().map_or(0, |(value, _)| *value)
    }

    /// The least value that so many of a million are not above.
    pub fn quantile(&self, per_million: u32) -> u64 {
        let rank = (u128::from(self.total) * u128::from(per_million)).div_ceil(1_000_000).max(1);
        let mut below = 0u128;
        for (value, count) in &self.counts {
            below += u128::from(*count);
            if below >= rank {
                return *value;
            }
        }
        self.max()
    }

    /// Bins of rising width between `edges`, which begin with 0 and rise; from the first that has a
    /// value in it to the last.
    pub fn bins(&self, edges: impl Iterator<Item = u64>) -> Vec<Bin> {
        let mut bins = Vec::new();
        let mut counts = self.counts.iter().copied().peekable();
        let mut from = 0;
        for to in edges.skip(1).chain([u64::MAX]) {
            let mut count = 0u64;
            while let Some((_, more)) = counts.next_if(|(value, _)| *value < to || to == u64::MAX) {
                count = count.saturating_add(more);
            }
            if count > 0 || !bins.is_empty() {
                bins.push(Bin { from, to, count });
            }
            from = to;
            if counts.peek().is_none() {
                break;
            }
        }
        bins
    }

    /// How many values are not above a value, for each value where that grows; at most about 2000
    /// of them.
    pub fn cumulative(&self) -> Vec<(u64, u64)> {
        let mut below = 0u64;
        let mut step = |value, count: u64| {
            below = below.saturating_add(count);
            (value, below)
        };
        if self.counts.len() <= STEPS {
            return self.counts.iter().map(|(value, count)| step(*value, *count)).collect();
        }
        let bins = self.bins(fine()).into_iter().filter(|bin| bin.count > 0);
        bins.map(|bin| step((bin.to - 1).min(self.max()), bin.count)).collect()
    }
}

/// 0, 1, 2, 3, 6, 11, 21, 51, ...: bins that end at 1, 2, 5, 10, 20, 50, ...
pub fn coarse() -> impl Iterator<Item = u64> {
    let ends = (0..19u32).flat_map(|n| [1, 2, 5].map(|m| m * 10u64.pow(n)));
    [0, 1].into_iter().chain(ends.map(|end| end + 1))
}

/// Twenty in each decade, and never narrower than 1.
pub fn medium() -> impl Iterator<Item = u64> {
    logarithmic(20)
}

fn fine() -> impl Iterator<Item = u64> {
    logarithmic(200)
}

fn logarithmic(per_decade: u32) -> impl Iterator<Item = u64> {
    let mut last = 0;
    let edges = (0..19 * per_decade).filter_map(move |n| {
        let edge = 10f64.powf(f64::from(n) / f64::from(per_decade)).round() as u64;
        let fresh = edge > last;
        last = last.max(edge);
        fresh.then_some(edge)
    });
    [0].into_iter().chain(edges)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(counts: &[(u64, u64)]) -> Distribution {
        Distribution::new(counts).unwrap()
    }

    #[test]
    fn quantiles_are_values_that_occurred() {
        let d = of(&[(5, 1), (0, 989), (2, 9), (100, 1)]);
        assert_eq!((d.total(), d.min(), d.max()), (1_000, 0, 100));
        let at = |per_million| d.quantile(per_million);
        assert_eq!([at(0), at(500_000), at(989_000), at(989_001)], [0, 0, 0, 2]);
        assert_eq!([at(998_000), at(999_000), at(999_001), at(1_000_000)], [2, 5, 100, 100]);
        assert_eq!(Distribution::new(&[]), None);
        assert_eq!(Distribution::new(&[(7, 0)]), None);
    }

    #[test]
    fn edges_rise_and_small_values_have_a_bin_each() {
        for edges in [coarse().collect::<Vec<_>>(), medium().collect(), fine().collect()] {
            assert!(edges.starts_with(&[0, 1, 2, 3]), "{edges:?}");
            assert!(edges.is_sorted_by(|a, b| a < b), "{edges:?}");
        }
        assert_eq!(coarse().take(9).collect::<Vec<_>>(), [0, 1, 2, 3, 6, 11, 21, 51, 101]);
    }

    #[test]
    fn every_value_is_in_the_bin_that_it_belongs_to() {
        let d = of(&[(2, 3), (3, 1), (5, 1), (6, 1), (100, 2)]);
        let bin = |from, to, count| Bin { from, to, count };
        let expected = [
            bin(2, 3, 3),
            bin(3, 6, 2),
            bin(6, 11, 1),
            bin(11, 21, 0),
            bin(21, 51, 0),
            bin(51, 101, 2),
        ];
        assert_eq!(d.bins(coarse()), expected);
    }

    #[test]
    fn no_value_is_lost_however_great() {
        let d = of(&[(0, 1), (u64::MAX, 2), (u64::MAX - 1, 3)]);
        for bins in [d.bins(coarse()), d.bins(medium()), d.bins(fine())] {
            assert_eq!(bins.iter().map(|b| b.count).sum::<u64>(), 6);
            assert!(bins.len() < 4_000);
        }
        assert_eq!(of(&[(1, u64::MAX), (1, 1)]).total(), u64::MAX);
    }

    #[test]
    fn the_cumulative_counts_end_with_all_at_the_greatest_value() {
        let d = of(&[(0, 4), (3, 2), (5_234, 1)]);
        assert_eq!(d.cumulative(), [(0, 4), (3, 6), (5_234, 7)]);
        let many: Vec<_> = (0..1_000_000).map(|n| (n * 7_919, 1)).collect();
        assert!(of(&many).cumulative().len() < 2_500);
    }
}
