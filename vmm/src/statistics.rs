//! From one record per window to the figures of a report.
//!
//! The records are made on the PLC's path and only copied there; everything that takes time, such
//! as sorting values into a histogram, happens here on the event thread.

use hdrhistogram::Histogram;
use serde::Serialize;
use takt_scheduler::time::{Nanos, TscFrequency};

use crate::vcpu::windowed::WindowRecord;

/// Digits that a percentile keeps. Minimum and maximum are exact.
const SIGNIFICANT_DIGITS: u8 = 3;

/// Values of one quantity, in nanoseconds.
pub struct Distribution {
    histogram: Histogram<u32>,
    min: u64,
    max: u64,
}

/// What a report says of a [`Distribution`], in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Smallest value, exact.
    pub min: u64,
    /// Median.
    pub p50: u64,
    /// 99 % of the values are at most this.
    pub p99: u64,
    /// 99.9 % of the values are at most this.
    pub p999: u64,
    /// Largest value, exact.
    pub max: u64,
}

impl Distribution {
    fn new() -> Option<Self> {
        let histogram = Histogram::new(SIGNIFICANT_DIGITS).ok()?;
        Some(Self { histogram, min: u64::MAX, max: 0 })
    }

    fn record(&mut self, value: Nanos) {
        self.min = self.min.min(value.0);
        self.max = self.max.max(value.0);
        // Grows as needed; only a value beyond 2^63 would be refused.
        let _ = self.histogram.record(value.0);
    }

    /// The percentiles; `None` while there is no value.
    #[must_use]
    pub fn summary(&self) -> Option<Summary> {
        let at = |q| self.histogram.value_at_quantile(q).clamp(self.min, self.max);
        (!self.histogram.is_empty()).then(|| Summary {
            min: self.min,
            p50: at(0.5),
            p99: at(0.99),
            p999: at(0.999),
            max: self.max,
        })
    }
}

/// What is known of a partition's releases.
pub struct Releases {
    frequency: TscFrequency,
    /// Releases at which the guest started its scan.
    pub happened: u64,
    /// Windows in which the guest started up, before its first scan.
    pub start_up: u64,
    /// Releases that never happened: the host came after the window's end, or the guest was still
    /// busy with an earlier scan.
    pub lost: u64,
    /// Releases for which the wake-up was later than the guard.
    pub late: u64,
    /// Windows that ended by a kick.
    pub overruns: u64,
    /// From the release to the guest's start.
    pub latency: Distribution,
    /// From the guest's start to its end, of scans that ended in their window.
    pub execution: Distribution,
    /// From the instant at which the thread was to wake up to when it did.
    pub wake_up: Distribution,
}

impl Releases {
    /// An empty account; `None` only if the histogram library refuses its constant parameter.
    #[must_use]
    pub fn new(frequency: TscFrequency) -> Option<Self> {
        Some(Self {
            frequency,
            happened: 0,
            start_up: 0,
            lost: 0,
            late: 0,
            overruns: 0,
            latency: Distribution::new()?,
            execution: Distribution::new()?,
            wake_up: Distribution::new()?,
        })
    }

    /// Adds one window.
    pub fn add(&mut self, record: &WindowRecord) {
        let nanos = |ticks| self.frequency.nanos(ticks);
        self.wake_up.record(nanos(record.woken.since(record.due)));
        let scan = record.scan();
        if self.happened == 0 && scan.is_none() {
            self.start_up += 1;
            return;
        }
        self.lost += record.skipped;
        self.late += u64::from(record.is_late());
        self.overruns += u64::from(record.overrun);
        let Some(scan) = scan else {
            self.lost += 1;
            return;
        };
        self.happened += 1;
        self.latency.record(nanos(scan.start.since(record.release)));
        if (scan.start..=record.left).contains(&scan.done) {
            self.execution.record(nanos(scan.done.since(scan.start)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vcpu::guest::Scan;
    use takt_scheduler::time::Tsc;

    fn record(claim: Option<(u64, u64)>) -> WindowRecord {
        WindowRecord {
            sequence: 0,
            skipped: 0,
            release: Tsc(1000),
            due: Tsc(980),
            woken: Tsc(985),
            entered: Tsc(990),
            left: Tsc(1300),
            claim: claim.map(|(start, done)| Scan { start: Tsc(start), done: Tsc(done) }),
            exits: 1,
            overrun: false,
        }
    }

    /// One tick is one nanosecond.
    fn account() -> Releases {
        Releases::new(TscFrequency::from_khz(1_000_000).unwrap()).unwrap()
    }

    #[test]
    fn a_good_window_is_a_release_with_latency_and_execution() {
        let mut account = account();
        account.add(&record(Some((1004, 1104))));
        assert_eq!((account.happened, account.lost, account.late), (1, 0, 0));
        assert_eq!(account.latency.summary().unwrap().max, 4);
        assert_eq!(account.execution.summary().unwrap().max, 100);
        assert_eq!(account.wake_up.summary().unwrap().max, 5);
    }

    #[test]
    fn a_window_without_a_credible_start_is_a_lost_release() {
        let mut account = account();
        account.add(&record(Some((1000, 1100))));
        account.add(&record(None));
        account.add(&record(Some((999, 1100))));
        account.add(&record(Some((1301, 1302))));
        account.add(&WindowRecord { skipped: 5, ..record(Some((1000, 1001))) });
        assert_eq!((account.happened, account.lost), (2, 8));
    }

    #[test]
    fn before_its_first_scan_a_guest_starts_up_and_loses_nothing() {
        let mut account = account();
        account.add(&WindowRecord { overrun: true, ..record(None) });
        account.add(&record(None));
        assert_eq!((account.start_up, account.lost, account.overruns), (2, 0, 0));
        account.add(&record(Some((1000, 1001))));
        account.add(&record(None));
        assert_eq!((account.start_up, account.happened, account.lost), (2, 1, 1));
    }

    #[test]
    fn a_scan_that_has_not_ended_has_no_execution_time() {
        let mut account = account();
        for done in [0, 999, 1301] {
            account.add(&record(Some((1000, done))));
        }
        assert_eq!((account.happened, account.execution.summary()), (3, None));
    }

    #[test]
    fn percentiles_are_within_the_exact_extremes() {
        let mut d = Distribution::new().unwrap();
        assert_eq!(d.summary(), None);
        for value in 1..=100_000 {
            d.record(Nanos(value));
        }
        let s = d.summary().unwrap();
        assert_eq!((s.min, s.max), (1, 100_000));
        let close = |a: u64, b: u64| a.abs_diff(b) * 1000 <= b;
        assert!(close(s.p50, 50_000) && close(s.p99, 99_000) && close(s.p999, 99_900), "{s:?}");
    }
}
