//! The wait for a guest's first scan.
//!
//! Until that scan a guest has no deadline to miss, since a start takes as long as it takes. But one that never
//! comes to it would be noticed by nothing else.

use std::mem;

use takt_scheduler::time::{Nanos, Tsc, TscFrequency};

use crate::health::Detail;

/// From the first window since its start, a guest has this long.
const PATIENCE: Nanos = Nanos::from_millis(10_000);

/// A guest's start, until its first scan.
#[derive(Debug, Default)]
pub(super) struct FirstScan {
    /// Release and instant of its first window.
    first: Option<(u64, Tsc)>,
    told: bool,
}

impl FirstScan {
    /// A window of these instants is over, and there was no scan yet: what is to be told, once.
    pub(super) fn missed(
        &mut self,
        sequence: u64,
        (release, end): (Tsc, Tsc),
        frequency: TscFrequency,
    ) -> Option<Detail> {
        let (first, began) = *self.first.get_or_insert((sequence, release));
        if frequency.nanos(end.since(began)) < PATIENCE || mem::replace(&mut self.told, true) {
            return None;
        }
        Some(Detail::Lost(sequence.saturating_sub(first).saturating_add(1), sequence))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guest_that_never_scans_is_told_of_once_after_each_start() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let mut first_scan = FirstScan::default();
        // Windows of 1 ms, in frames of 100 ms, from release 7 on.
        let mut window = |sequence: u64| {
            let release = 5_000 + sequence * 100_000_000;
            first_scan.missed(sequence, (Tsc(release), Tsc(release + 1_000_000)), frequency)
        };
        for sequence in 7..107 {
            assert_eq!(window(sequence), None, "{sequence}");
        }
        assert_eq!(window(107), Some(Detail::Lost(101, 107)));
        assert!((108..1_000).all(|sequence| window(sequence).is_none()));

        let mut first_scan = FirstScan::default();
        let long = (Tsc(0), Tsc(10_000_000_000));
        assert_eq!(first_scan.missed(3, long, frequency), Some(Detail::Lost(1, 3)));
    }
}
