//! The scan cycle: one scan per release, started at the release instant.
//!
//! The host wakes the vCPU a little before the release and the guest waits for the rest of the
//! time on the time stamp counter. What the host's wake-up costs, and how much that varies, is
//! thereby taken out of the start of the scan; what remains is one turn of a loop of five
//! instructions. The loop contains no `pause`: that would save power for the few microseconds it
//! lasts, but its duration differs between processors from ten to over a hundred cycles, and under
//! KVM it can be made to exit; both would be jitter.
//!
//! A scan that is not done at the end of its window is interrupted by the host, at any
//! instruction, and continues in a later window as if nothing had happened. It then finishes late,
//! and the releases that passed meanwhile are lost: they are not made up, they are counted
//! ([`Cycle::missed`]). The information page may be written for a new window at such a point, which
//! is why the wait reads it anew in each turn, and why a copy of the page counts only if the wait
//! has also reached *its* release.

use crate::{pages, port};
use core::arch::asm;
use core::arch::x86_64::_rdtsc;
use core::time::Duration;
use takt_abi::{Information, port::DONE};

/// What a scan is told about its place in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cycle {
    /// Sequence number of this release in the schedule.
    pub release: u64,
    /// Major frame in which it lies.
    pub frame: u64,
    /// Releases lost since the last scan, 0 when all is well.
    pub missed: u64,
    /// Time from the first executed release to this one.
    pub time: Duration,
    /// Time from the last executed release to this one, 0 in the first scan. It is taken from the
    /// schedule and not from when the scans really started, so it has no jitter.
    pub elapsed: Duration,
}

/// A control program.
pub trait Program {
    /// Reads inputs, computes, writes outputs; must return within the window.
    fn scan(&mut self, cycle: &Cycle);
}

/// Runs a program for ever, once per release.
///
/// What the guest did to start up may have reached into a window, at any point of it. The first
/// "done" gives the rest of that window back, so that the first scan starts at a release.
pub fn run(mut program: impl Program) -> ! {
    let mut history = History::default();
    port::write(DONE, 0);
    loop {
        let (information, start) = wait();
        pages::publish_start(information.release, start);
        program.scan(&history.next(&information));
        pages::publish_done(now());
        port::write(DONE, 0);
    }
}

/// Waits for the next release. Returns the information page as of that release, and the time stamp
/// that ended the wait.
#[must_use]
pub fn wait() -> (Information, u64) {
    loop {
        let tsc = wait_for_release_tsc();
        let information = pages::information();
        if information.release_tsc <= tsc {
            return (information, tsc);
        }
    }
}

/// The time stamp counter. It is not ordered against neighbouring instructions; that is an error
/// of some nanoseconds, a serialising instruction would cost more than that.
#[must_use]
#[inline]
pub fn now() -> u64 {
    // SAFETY: `rdtsc` has no preconditions in ring 0.
    unsafe { _rdtsc() }
}

fn wait_for_release_tsc() -> u64 {
    let tsc: u64;
    // SAFETY: the operand is the mapped, readable field of the information page.
    unsafe {
        asm!(
            "2:",
            "rdtsc",
            "shl rdx, 32",
            "or rax, rdx",
            "cmp rax, [{release}]",
            "jb 2b",
            release = in(reg) pages::RELEASE_TSC,
            out("rax") tsc,
            out("rdx") _,
            options(readonly, nostack),
        );
    }
    tsc
}

/// What the next [`Cycle`] is reckoned from.
#[derive(Default)]
struct History {
    /// Time stamp of the first executed release.
    first_tsc: Option<u64>,
    last: Option<Cycle>,
}

impl History {
    fn next(&mut self, information: &Information) -> Cycle {
        let first_tsc = *self.first_tsc.get_or_insert(information.release_tsc);
        // From the first release each time, so that rounding does not add up.
        let time = duration(information.release_tsc.saturating_sub(first_tsc), information.tsc_khz);
        let release = information.release;
        let (missed, elapsed) = self.last.map_or((0, Duration::ZERO), |last| {
            (release.saturating_sub(last.release.saturating_add(1)), time.saturating_sub(last.time))
        });
        let cycle = Cycle { release, frame: information.frame, missed, time, elapsed };
        self.last = Some(cycle);
        cycle
    }
}

fn duration(ticks: u64, tsc_khz: u64) -> Duration {
    let per_second = tsc_khz.saturating_mul(1000).max(1);
    let nanoseconds = u128::from(ticks % per_second) * 1_000_000_000 / u128::from(per_second);
    Duration::from_secs(ticks / per_second) + Duration::from_nanos(nanoseconds as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::start::{COLD, NORMAL};
    use takt_abi::{MAGIC, VERSION};

    const KHZ: u64 = 2_994_374;

    fn information(release: u64, release_tsc: u64) -> Information {
        Information {
            magic: MAGIC,
            version: VERSION,
            memory_bytes: 4 << 20,
            tsc_khz: KHZ,
            major_frame_ns: 1_000_000,
            release,
            frame: release,
            release_tsc,
            window_end_tsc: release_tsc.saturating_add(KHZ / 4),
            next_release_tsc: release_tsc.saturating_add(KHZ),
            next_window_end_tsc: release_tsc.saturating_add(KHZ * 5 / 4),
            schedule: 0,
            start_mode: COLD,
            start_condition: NORMAL,
            interrupt_controller: 0,
        }
    }

    #[test]
    fn the_first_scan_has_no_past() {
        let cycle = History::default().next(&information(7, 123_456));
        assert_eq!((cycle.release, cycle.missed), (7, 0));
        assert_eq!((cycle.time, cycle.elapsed), (Duration::ZERO, Duration::ZERO));
    }

    #[test]
    fn consecutive_releases_miss_nothing() {
        let mut history = History::default();
        for release in 0..5 {
            let cycle = history.next(&information(release, 1_000 + release * KHZ));
            assert_eq!(cycle.missed, 0);
            assert_eq!(cycle.time, Duration::from_millis(release));
            assert_eq!(cycle.elapsed, Duration::from_millis(release.min(1)));
        }
    }

    #[test]
    fn a_gap_is_counted_once_and_is_in_the_elapsed_time() {
        let mut history = History::default();
        history.next(&information(10, 10 * KHZ));
        let late = history.next(&information(14, 14 * KHZ));
        assert_eq!((late.missed, late.elapsed), (3, Duration::from_millis(4)));
        let after = history.next(&information(15, 15 * KHZ));
        assert_eq!((after.missed, after.elapsed), (0, Duration::from_millis(1)));
    }

    #[test]
    fn rounding_does_not_add_up() {
        let mut history = History::default();
        history.next(&information(0, 0));
        // A third of a millisecond is no whole number of nanoseconds.
        let sum: Duration =
            (1..=300_000).map(|n| history.next(&information(n, n * KHZ / 3)).elapsed).sum();
        assert_eq!(sum, Duration::from_secs(100));
    }

    #[test]
    fn nonsense_from_the_host_does_not_panic() {
        let mut history = History::default();
        history.next(&information(u64::MAX, u64::MAX));
        let mut zero = information(0, 0);
        zero.tsc_khz = 0;
        let back = history.next(&zero);
        assert_eq!((back.missed, back.elapsed), (0, Duration::ZERO));
        assert!(duration(u64::MAX, 0) > Duration::from_secs(1));
        assert_eq!(duration(u64::MAX, u64::MAX), Duration::from_secs(1));
    }
}
