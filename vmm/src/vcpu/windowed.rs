//! Running a partition in its windows.
//!
//! Release `n` lies at a fixed place on the TSC, computed from `n` alone: nothing that happens in
//! one window can move the next. The thread wakes a guard time early and enters the guest, which
//! itself waits for the exact instant; the latency of the wake-up disappears in that wait.

use rtrb::Producer;
use takt_scheduler::enforce::{Woken, sleep_until};
use takt_scheduler::table::{Release, Releases};
use takt_scheduler::time::{Ticks, Timebase, Tsc};

use super::Control;
use super::guest::{End, Guest, KvmFailure, Scan, Step};
use super::kick::Kickable;

/// When a partition runs.
pub struct Plan {
    /// Its windows.
    pub releases: Releases,
    /// Where they lie on the TSC.
    pub base: Timebase,
    /// How long before a window the thread wakes.
    pub guard: Ticks,
}

/// What happened in one window. Written once, at its end, into a ring that another thread reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowRecord {
    /// Which release.
    pub sequence: u64,
    /// Releases before this one that were skipped because the host came too late for them.
    pub skipped: u64,
    /// Where the release lies.
    pub release: Tsc,
    /// When the thread was to wake up.
    pub due: Tsc,
    /// When it did.
    pub woken: Tsc,
    /// Last look at the clock before the guest was entered first.
    pub entered: Tsc,
    /// When the guest was left last.
    pub left: Tsc,
    /// What the guest claims of this release; checked by [`WindowRecord::scan`].
    pub claim: Option<Scan>,
    /// Exits from the guest, "done" included.
    pub exits: u32,
    /// True if the guest had to be kicked out.
    pub overrun: bool,
}

impl WindowRecord {
    /// True if the wake-up was later than the guard, so that the release itself was late.
    #[must_use]
    pub fn is_late(&self) -> bool {
        self.entered > self.release
    }

    /// The guest's claim, if it is one that can be true: a scan does not start before its
    /// release or after its window.
    #[must_use]
    pub fn scan(&self) -> Option<Scan> {
        self.claim.filter(|scan| (self.release..=self.left).contains(&scan.start))
    }
}

/// How a window ended.
enum Outcome {
    Done,
    Expired,
    Ended(End),
}

/// Runs the guest in its windows until it ends or is stopped.
///
/// `records` gets one record for each window; what does not fit is counted in the second part of
/// the result.
pub fn run(
    kickable: &mut Kickable,
    guest: &mut impl Guest,
    control: &Control,
    plan: &Plan,
    records: &mut Producer<WindowRecord>,
) -> (End, u64) {
    let mut unrecorded = 0;
    let mut release = plan.releases.nth(0);
    let mut skipped = 0;
    loop {
        let start = plan.base.instant(release.start);
        let end = plan.base.instant(release.end);
        let due = start.before(plan.guard);
        while sleep_until(due, plan.base.frequency) == Woken::BySignal {
            if control.stopping() {
                return (End::Stopped, unrecorded);
            }
        }
        let woken = Tsc::now();
        if woken >= end {
            let next = plan.releases.first_ending_after(plan.base.offset(woken));
            skipped += next.sequence.saturating_sub(release.sequence);
            release = next;
            continue;
        }
        guest.announce(&release, &plan.base);
        let (entered, exits, outcome) = run_window(kickable, guest, control, end);
        let left = Tsc::now();
        control.leave_window();
        if let Outcome::Ended(ended) = outcome {
            return (ended, unrecorded);
        }
        let record = WindowRecord {
            sequence: release.sequence,
            skipped,
            release: start,
            due,
            woken,
            entered,
            left,
            claim: guest.claim(release.sequence),
            exits,
            overrun: matches!(outcome, Outcome::Expired) && guest.says_done(),
        };
        if records.push(record).is_err() {
            unrecorded += 1;
        }
        skipped = 0;
        release = following(&plan.releases, &release);
    }
}

fn following(releases: &Releases, release: &Release) -> Release {
    releases.nth(release.sequence.saturating_add(1))
}

/// Runs the guest until it is done, its window ends, or it does.
fn run_window(
    kickable: &mut Kickable,
    guest: &mut impl Guest,
    control: &Control,
    end: Tsc,
) -> (Tsc, u32, Outcome) {
    control.enter_window(end);
    let mut exits = 0u32;
    let mut entered = None;
    loop {
        kickable.clear();
        let now = Tsc::now();
        let first = *entered.get_or_insert(now);
        if control.stopping() {
            return (first, exits, Outcome::Ended(End::Stopped));
        }
        if now >= end {
            return (first, exits, Outcome::Expired);
        }
        match kickable.vcpu().run() {
            Ok(exit) => {
                exits = exits.saturating_add(1);
                match guest.handle(exit) {
                    Step::Resume => {}
                    Step::Done => return (first, exits, Outcome::Done),
                    Step::Ended(ended) => return (first, exits, Outcome::Ended(ended)),
                }
            }
            Err(e) if matches!(e.errno(), libc::EINTR | libc::EAGAIN) => {}
            Err(e) => {
                let failure = End::Kvm(KvmFailure::Errno(e.errno()));
                return (first, exits, Outcome::Ended(failure));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(release: u64, entered: u64, left: u64, start: u64) -> WindowRecord {
        WindowRecord {
            sequence: 0,
            skipped: 0,
            release: Tsc(release),
            due: Tsc(release - 20),
            woken: Tsc(entered),
            entered: Tsc(entered),
            left: Tsc(left),
            claim: Some(Scan { start: Tsc(start), done: Tsc(0) }),
            exits: 1,
            overrun: false,
        }
    }

    #[test]
    fn a_wake_up_later_than_the_guard_makes_a_late_release() {
        assert!(!record(100, 95, 200, 100).is_late());
        assert!(!record(100, 100, 200, 100).is_late());
        assert!(record(100, 101, 200, 101).is_late());
    }

    #[test]
    fn a_claim_outside_the_window_is_not_believed() {
        assert!(record(100, 95, 200, 100).scan().is_some());
        for impossible in [0, 99, 201, u64::MAX] {
            assert_eq!(record(100, 95, 200, impossible).scan(), None);
        }
    }
}
