//! From the records of windows to the figures of a report.
//!
//! The records are made on the PLC's path and only copied there; everything that takes time, such
//! as sorting values into a histogram, happens here on the supervisor thread.

use takt_scheduler::time::{Nanos, Timebase};

use crate::bins::Bins;
use crate::report::{self, Summary};
use crate::worst::Worst;
use takt_record::{Detour, Skipped, WindowRecord};

/// Longer than a guest that waits for its release takes to see it: a start that is later has a cause
/// that is told.
const REMARKABLE_NS: u64 = 11;
/// Releases, and scans, of which a report tells the cause.
const WORST: usize = 10;

/// Values of one quantity: nanoseconds, or a count. Minimum and maximum are exact.
pub struct Distribution {
    bins: Bins,
    min: u64,
    max: u64,
    sum: u64,
}

impl Distribution {
    pub(crate) fn new() -> Option<Self> {
        Some(Self { bins: Bins::new()?, min: u64::MAX, max: 0, sum: 0 })
    }

    pub(crate) fn record(&mut self, Nanos(value): Nanos) {
        self.count(value);
    }

    fn count(&mut self, value: u64) {
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.sum = self.sum.saturating_add(value);
        self.bins.record(value);
    }

    /// All values, in rising order, and how often each occurred. Values that are too close to be
    /// kept apart are one, the greatest possible; the first and the last are exact.
    #[must_use]
    pub fn counts(&self) -> Vec<(u64, u64)> {
        let mut counts = self.bins.counts();
        counts.iter_mut().for_each(|(value, _)| *value = (*value).clamp(self.min, self.max));
        match &mut counts[..] {
            [(only, count)] if self.min < self.max => {
                (*only, *count) = (self.min, *count - 1);
                counts.push((self.max, 1));
            }
            [(first, _), ..] => *first = self.min,
            [] => {}
        }
        counts
    }

    /// The percentiles; `None` while there is no value.
    #[must_use]
    pub fn summary(&self) -> Option<Summary> {
        let at = |q| self.bins.value_at_quantile(q).clamp(self.min, self.max);
        (self.min <= self.max).then(|| Summary {
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
    base: Timebase,
    /// True until the first scan after a start.
    starting: bool,
    /// Releases at which the guest started its scan.
    happened: u64,
    /// Windows in which the guest started up, before its first scan, those that the host slept through included.
    start_up: u64,
    /// Releases that never happened: the host came after the window's end, or the guest was still
    /// busy with an earlier scan.
    lost: u64,
    /// Wake-ups that were later than the guard, so that their release was late or even lost.
    late: u64,
    /// Windows that ended before the guest was done, and before its scan was.
    overruns: u64,
    /// Windows that ended after the scan, while tasks went on.
    unfinished: u64,
    /// From the release to the guest's start.
    latency: Distribution,
    /// From the guest's start to its end, of scans that ended in their window.
    execution: Distribution,
    /// From the instant at which the thread was to wake up to when it did.
    wake_up: Distribution,
    /// From the instant at which the thread was to wake up to the release.
    guard: Distribution,
    /// From the thread's wake-up to its last look at the clock before the guest.
    entry: Distribution,
    /// From the guest's end of its scan to the thread's being out of the guest.
    exit: Distribution,
    /// From a window's end to the guest's last stamp, in overruns.
    last_stamp: Distribution,
    /// From a window's end to the thread's being out of the guest, where the guest was not done.
    kick: Distribution,
    /// Exits in a window, as KVM counts them.
    vm_exits: Distribution,
    worst: Worst,
}

impl Releases {
    /// An empty account; `None` only if the histogram library refuses its constant parameter.
    #[must_use]
    pub fn new(base: Timebase) -> Option<Self> {
        Some(Self {
            base,
            starting: true,
            happened: 0,
            start_up: 0,
            lost: 0,
            late: 0,
            overruns: 0,
            unfinished: 0,
            latency: Distribution::new()?,
            execution: Distribution::new()?,
            wake_up: Distribution::new()?,
            guard: Distribution::new()?,
            entry: Distribution::new()?,
            exit: Distribution::new()?,
            last_stamp: Distribution::new()?,
            kick: Distribution::new()?,
            vm_exits: Distribution::new()?,
            worst: Worst::new(base, WORST),
        })
    }

    /// Windows so far.
    #[must_use]
    pub fn windows(&self) -> u64 {
        self.happened.saturating_add(self.start_up).saturating_add(self.lost)
    }

    /// Sum of all release latencies in nanoseconds. It is exact, so the mean over a part of the run
    /// follows from two of them.
    #[must_use]
    pub fn latency_sum(&self) -> u64 {
        self.latency.sum
    }

    /// From the release to the guest's start.
    #[must_use]
    pub fn latency(&self) -> &Distribution {
        &self.latency
    }

    /// From the guest's start to its end, of scans that ended in their window.
    #[must_use]
    pub fn execution(&self) -> &Distribution {
        &self.execution
    }

    /// The guest is started anew: until its first scan it loses nothing.
    pub fn restarted(&mut self) {
        self.starting = true;
    }

    /// Adds a window with its detours.
    pub fn add(&mut self, record: &WindowRecord, detours: &[Detour]) {
        let frequency = self.base.frequency;
        let nanos = |ticks| frequency.nanos(ticks);
        let scan = record.scan();
        if self.starting && scan.is_none() {
            // A guest that is started anew may be so in the middle of a window, for which its
            // thread did not sleep: how late that is tells nothing of the host.
            self.start_up += 1;
            return;
        }
        self.wake_up.record(nanos(record.woken.since(record.due)));
        self.guard.record(nanos(record.release.since(record.due)));
        self.entry.record(nanos(record.entered.since(record.woken)));
        self.starting = false;
        self.late += u64::from(record.is_late());
        if record.overrun {
            self.overruns += 1;
            if (record.release..=record.left).contains(&record.last_stamp) {
                self.last_stamp.record(nanos(record.last_stamp.since(record.end)));
            }
        }
        self.unfinished += u64::from(record.unfinished);
        if record.overrun || record.unfinished {
            self.kick.record(nanos(record.left.since(record.end)));
        }
        let Some(scan) = scan else {
            self.lost += 1;
            return;
        };
        self.happened += 1;
        if record.kernel_exits > 0 {
            self.vm_exits.count(record.kernel_exits);
        }
        self.worst.add(record, detours);
        self.latency.record(nanos(scan.start.since(record.release)));
        if record.finished_scan().is_some() {
            self.execution.record(nanos(scan.done.since(scan.start)));
            // Where tasks may follow the scan, its end is not the guest's.
            if !record.overrun && !record.ended && !record.has_tasks {
                self.exit.record(nanos(record.left.since(scan.done)));
            }
        }
    }

    /// Adds releases that passed while the thread was not there.
    pub fn skip(&mut self, skipped: &Skipped) {
        if self.starting {
            self.start_up += skipped.count;
            return;
        }
        self.lost += skipped.count;
        self.late += 1;
        self.wake_up.record(self.base.frequency.nanos(skipped.woken.since(skipped.due)));
    }

    /// The figures; `unrecorded` windows are in none of them.
    #[must_use]
    pub fn report(&self, unrecorded: u64) -> report::Releases {
        report::Releases {
            releases: self.happened,
            start_up_windows: self.start_up,
            lost: self.lost,
            late_releases: self.late,
            overruns: self.overruns,
            unfinished_windows: self.unfinished,
            unrecorded,
            release_latency_ns: self.latency.summary(),
            execution_ns: self.execution.summary(),
            wake_up_latency_ns: self.wake_up.summary(),
            release_guard_ns: self.guard.summary(),
            entry_ns: self.entry.summary(),
            exit_ns: self.exit.summary(),
            overrun_ns: self.last_stamp.summary(),
            kick_ns: self.kick.summary(),
            vm_exits: self.vm_exits.summary(),
            late_starts: self.worst.starts().filter(|s| s.latency_ns >= REMARKABLE_NS).collect(),
            longest_scans: self.worst.scans().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_record::Scan;
    use takt_scheduler::schedules::ScheduleId;
    use takt_scheduler::time::{Tsc, TscFrequency};

    fn record(claim: Option<(u64, u64)>) -> WindowRecord {
        WindowRecord {
            sequence: 0,
            schedule: ScheduleId(0),
            skipped: 0,
            release: Tsc(1000),
            end: Tsc(1290),
            due: Tsc(980),
            woken: Tsc(985),
            entered: Tsc(990),
            left: Tsc(1300),
            kicked: None,
            claim: claim.map(|(start, done)| Scan { start: Tsc(start), done: Tsc(done) }),
            last_stamp: Tsc(0),
            exits: 1,
            kernel_exits: 1,
            overrun: false,
            unfinished: false,
            has_tasks: false,
            ended: false,
        }
    }

    /// One tick is one nanosecond.
    fn account() -> Releases {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        Releases::new(Timebase { epoch: Tsc(0), frequency }).unwrap()
    }

    #[test]
    fn a_good_window_is_a_release_with_latency_and_execution() {
        let mut account = account();
        account.add(&record(Some((1004, 1104))), &[]);
        let r = account.report(0);
        assert_eq!((r.releases, r.lost, r.late_releases), (1, 0, 0));
        let max = |summary: Option<Summary>| summary.map(|s| s.max);
        assert_eq!((max(r.release_latency_ns), max(r.execution_ns)), (Some(4), Some(100)));
        assert_eq!((max(r.wake_up_latency_ns), max(r.entry_ns)), (Some(5), Some(5)));
        assert_eq!(max(r.release_guard_ns), Some(20));
        assert_eq!(max(r.vm_exits), Some(1));
        assert_eq!((max(r.exit_ns), max(r.kick_ns)), (Some(196), None));
        assert!(r.late_starts.is_empty());
        assert_eq!(account.latency_sum(), 4);
        account.add(&record(Some((1010, 1104))), &[]);
        assert!(account.report(0).late_starts.is_empty());
        account.add(&record(Some((1011, 1104))), &[]);
        assert_eq!(account.report(0).late_starts[0].latency_ns, 11);
    }

    #[test]
    fn a_window_without_a_credible_start_is_a_lost_release() {
        let mut account = account();
        account.add(&record(Some((1000, 1100))), &[]);
        account.add(&record(None), &[]);
        account.add(&record(Some((999, 1100))), &[]);
        account.add(&record(Some((1301, 1302))), &[]);
        account.add(&record(Some((1000, 1001))), &[]);
        let r = account.report(0);
        assert_eq!((r.releases, r.lost), (2, 3));
    }

    #[test]
    fn releases_that_the_host_slept_through_are_lost_and_their_wake_up_is_one() {
        let mut account = account();
        let skipped = |count, woken| Skipped { count, due: Tsc(980), woken: Tsc(woken) };
        // It is still starting up.
        account.skip(&skipped(3, 90_000));
        account.add(&record(Some((1004, 1104))), &[]);
        // The window after them tells of them too.
        account.skip(&skipped(5, 5_980));
        account.add(&WindowRecord { skipped: 5, ..record(Some((1004, 1104))) }, &[]);
        // After these there is no window.
        account.skip(&skipped(10_000, 2_980));
        let r = account.report(0);
        assert_eq!((r.start_up_windows, r.releases), (3, 2));
        assert_eq!((r.lost, r.late_releases), (10_005, 2));
        let wake_up = r.wake_up_latency_ns.unwrap();
        assert_eq!((wake_up.min, wake_up.max), (5, 5_000));
    }

    #[test]
    fn before_its_first_scan_a_guest_starts_up_and_loses_nothing() {
        let mut account = account();
        account.add(&WindowRecord { overrun: true, ..record(None) }, &[]);
        account.add(&record(None), &[]);
        let r = account.report(0);
        assert_eq!((r.start_up_windows, r.lost, r.overruns), (2, 0, 0));
        account.add(&record(Some((1000, 1001))), &[]);
        account.add(&record(None), &[]);
        account.restarted();
        account.add(&WindowRecord { woken: Tsc(1200), ..record(None) }, &[]);
        account.add(&record(Some((1000, 1001))), &[]);
        let r = account.report(0);
        assert_eq!(r.wake_up_latency_ns.map(|s| s.max), Some(5));
        assert_eq!((r.start_up_windows, r.releases, r.lost), (3, 2, 1));
    }

    #[test]
    fn an_overrun_tells_when_the_guest_last_ran_if_that_can_be_true() {
        let mut account = account();
        account.add(&record(Some((1000, 1100))), &[]);
        for last_stamp in [1295, 0, u64::MAX] {
            let last_stamp = Tsc(last_stamp);
            account.add(&WindowRecord { overrun: true, last_stamp, ..record(None) }, &[]);
        }
        let r = account.report(0);
        assert_eq!(r.overruns, 3);
        let (stamp, kick) = (r.overrun_ns.unwrap(), r.kick_ns.unwrap());
        assert_eq!((stamp.min, stamp.max, kick.max), (5, 5, 10));
    }

    #[test]
    fn a_window_in_which_tasks_go_on_is_no_overrun_and_has_a_kick() {
        let mut account = account();
        let with_tasks = WindowRecord { has_tasks: true, ..record(Some((1000, 1100))) };
        account.add(&with_tasks, &[]);
        account.add(&WindowRecord { unfinished: true, ..with_tasks }, &[]);
        let r = account.report(0);
        assert_eq!((r.releases, r.overruns, r.unfinished_windows), (2, 0, 1));
        assert_eq!((r.kick_ns.map(|s| s.max), r.exit_ns), (Some(10), None));
    }

    #[test]
    fn a_scan_that_has_not_ended_has_no_execution_time() {
        let mut account = account();
        for done in [0, 999, 1301] {
            account.add(&record(Some((1000, done))), &[]);
        }
        let r = account.report(0);
        assert_eq!((r.releases, r.execution_ns), (3, None));
    }

    #[test]
    fn the_first_and_the_last_of_the_counts_are_exact() {
        for (values, expected) in [
            (&[][..], &[][..]),
            (&[9_001, 9_001], &[(9_001, 2)]),
            (&[9_001, 9_002, 9_003], &[(9_001, 2), (9_003, 1)]),
            (&[9_001, 50_000, 90_001], &[(9_001, 1), (50_015, 1), (90_001, 1)]),
        ] {
            let mut d = Distribution::new().unwrap();
            values.iter().for_each(|value| d.record(Nanos(*value)));
            assert_eq!(d.counts(), expected);
        }
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
        let counts = d.counts();
        assert_eq!(counts.iter().map(|(_, count)| count).sum::<u64>(), 100_000);
        assert_eq!((counts[0], counts[2_000]), ((1, 1), (2_001, 1)));
        assert_eq!(counts.last().map(|(value, _)| *value), Some(100_000));
        assert!(close(s.p50, 50_000) && close(s.p99, 99_000) && close(s.p999, 99_900), "{s:?}");
    }
}
