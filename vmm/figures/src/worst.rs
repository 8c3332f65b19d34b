//! The worst releases and the longest scans of a run, each with its cause.
//!
//! A percentile says that something happened, not when or why. These few say it for the values
//! that make the maximum. A bounded number of them is kept, so a run may last for ever.

use serde::{Deserialize, Serialize};
use takt_scheduler::time::{Nanos, Timebase};

use crate::cause::{CauseName, Explanation, ScanTime, of_start};
use takt_record::{Detour, WindowRecord};

/// A release that started late. Times are nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LateStart {
    /// Its sequence number.
    pub release: u64,
    /// Where it lies after the epoch.
    pub at_ns: u64,
    /// From the release to the guest's start.
    pub latency_ns: u64,
    /// What explains most of it; `null` if there is nothing to explain.
    pub cause: Option<CauseName>,
    /// All of it.
    pub parts: Explanation,
}

/// A scan that took long. Times are nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LongScan {
    /// Sequence number of its release.
    pub release: u64,
    /// Where that lies after the epoch.
    pub at_ns: u64,
    /// From the guest's start to its end, or to that of the window.
    pub execution_ns: u64,
    /// False if the window ended first.
    pub finished: bool,
    /// The part that needs no explanation: the least that any scan of the run spent in the guest.
    pub usual_ns: u64,
    /// What explains most of the rest; `null` if there is no rest.
    pub cause: Option<CauseName>,
    /// All of the rest.
    pub parts: Explanation,
}

/// Keeps the worst of one partition.
#[derive(Debug)]
pub struct Worst {
    base: Timebase,
    starts: Ranking<LateStart>,
    scans: Ranking<(u64, u64, ScanTime)>,
    /// Least time that a finished scan spent in the guest.
    usual: Option<Nanos>,
}

impl Worst {
    /// Keeps up to `limit` releases and as many scans; allocates only here.
    #[must_use]
    pub fn new(base: Timebase, limit: usize) -> Self {
        Self { base, starts: Ranking::new(limit), scans: Ranking::new(limit), usual: None }
    }

    /// Adds a window with its detours.
    pub fn add(&mut self, record: &WindowRecord, detours: &[Detour]) {
        let frequency = self.base.frequency;
        let (Some(scan), Some(parts)) = (record.scan(), of_start(record, detours, frequency))
        else {
            return;
        };
        let release = record.sequence;
        let at_ns = self.base.offset(record.release).0;
        let latency_ns = frequency.nanos(scan.start.since(record.release)).0;
        let cause = parts.main().map(|part| part.cause.name());
        self.starts.add(latency_ns, LateStart { release, at_ns, latency_ns, cause, parts });
        if let Some(time) = ScanTime::of(record, detours, frequency) {
            if time.finished {
                self.usual = Some(self.usual.map_or(time.in_guest, |u| u.min(time.in_guest)));
            }
            self.scans.add(time.execution.0, (release, at_ns, time));
        }
    }

    /// The releases that started latest, the worst first; of equals, the earlier one.
    pub fn starts(&self) -> impl Iterator<Item = LateStart> {
        self.starts.items()
    }

    /// The longest scans, the longest first; of equals, the earlier one.
    pub fn scans(&self) -> impl Iterator<Item = LongScan> {
        let usual = self.usual.unwrap_or(Nanos::ZERO);
        self.scans.items().map(move |(release, at_ns, time)| {
            let parts = time.explain(usual);
            LongScan {
                release,
                at_ns,
                execution_ns: time.execution.0,
                finished: time.finished,
                usual_ns: usual.0,
                cause: parts.main().map(|part| part.cause.name()),
                parts,
            }
        })
    }
}

/// The items with the greatest weights, in falling order.
#[derive(Debug)]
struct Ranking<T> {
    items: Vec<(u64, T)>,
    limit: usize,
}

impl<T: Copy> Ranking<T> {
    fn new(limit: usize) -> Self {
        Self { items: Vec::with_capacity(limit), limit }
    }

    fn add(&mut self, weight: u64, item: T) {
        let place = self.items.partition_point(|(other, _)| *other >= weight);
        if place < self.limit {
            // Room first: the vector must not grow.
            self.items.truncate(self.limit - 1);
            self.items.insert(place, (weight, item));
        }
    }

    fn items(&self) -> impl Iterator<Item = T> {
        self.items.iter().map(|(_, item)| *item)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_record::Scan;
    use takt_record::example as record;
    use takt_scheduler::time::{Tsc, TscFrequency};

    /// One tick is one nanosecond.
    fn worst(limit: usize) -> Worst {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        Worst::new(Timebase { epoch: Tsc(1_000), frequency }, limit)
    }

    #[test]
    fn the_worst_are_kept_and_the_earlier_of_equals() {
        let mut worst = worst(3);
        for (sequence, latency) in [5, 9, 5, 1, 9, 5, 0].into_iter().enumerate() {
            worst.add(&record(sequence as u64, latency, 100), &[]);
        }
        let kept: Vec<_> = worst.starts().map(|s| (s.release, s.at_ns, s.latency_ns)).collect();
        assert_eq!(kept, [(1, 1_000, 9), (4, 4_000, 9), (0, 0, 5)]);
        assert!(worst.scans().map(|s| s.release).eq(0..3));
    }

    #[test]
    fn a_scan_is_measured_against_the_shortest_whenever_that_was() {
        let mut worst = worst(2);
        worst.add(&record(0, 0, 500), &[]);
        worst.add(&record(1, 0, 100), &[]);
        // Shorter, but not finished: how short it is says nothing.
        let unfinished = WindowRecord { overrun: true, left: Tsc(3_050), ..record(2, 0, 900) };
        worst.add(&unfinished, &[]);
        let scans: Vec<_> = worst.scans().collect();
        let brief = |s: &LongScan| (s.release, s.execution_ns, s.usual_ns, s.cause);
        assert_eq!(brief(&scans[0]), (0, 500, 100, Some(CauseName::GuestComputation)));
        assert_eq!(brief(&scans[1]), (1, 100, 100, None));
        assert_eq!(scans[0].parts.main().unwrap().explains_ns, 400);
    }

    #[test]
    fn memory_does_not_grow() {
        for limit in [0, 1, 10] {
            let mut worst = worst(limit);
            let capacity = (worst.starts.items.capacity(), worst.scans.items.capacity());
            for n in 0..1_000 {
                worst.add(&record(n, n % 400, n % 200), &[]);
            }
            assert_eq!(worst.starts().count(), limit);
            assert_eq!(capacity, (worst.starts.items.capacity(), worst.scans.items.capacity()));
        }
    }

    #[test]
    fn windows_without_a_credible_claim_are_not_ranked() {
        let mut worst = worst(4);
        worst.add(&WindowRecord { claim: None, ..record(0, 0, 0) }, &[]);
        for start in [0, 999, 1_901, u64::MAX] {
            let claim = Some(Scan { start: Tsc(start), done: Tsc(u64::MAX) });
            worst.add(&WindowRecord { claim, ..record(0, 0, 0) }, &[]);
        }
        assert_eq!((worst.starts().count(), worst.scans().count()), (0, 0));
    }

    #[test]
    fn the_report_gets_its_keys() {
        let mut worst = worst(1);
        worst.add(&record(3, 7, 100), &[]);
        let start = serde_json::to_value(worst.starts().next().unwrap()).unwrap();
        assert_eq!(start["cause"], "late_wake_up");
        assert_eq!(start["parts"][0]["explains_ns"], 7);
        let scan = serde_json::to_value(worst.scans().next().unwrap()).unwrap();
        for key in ["release", "at_ns", "execution_ns", "finished", "usual_ns", "parts"] {
            assert!(!scan[key].is_null(), "{key}");
        }
    }
}
