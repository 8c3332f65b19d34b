//! What happened in a window: written on the PLC's path, read by another thread.
//!
//! The instants of a window are few and always the same, so they are one value of fixed size that
//! is pushed into a ring when the window is over. Only an exit that is *not* the window's last has
//! a record of its own, up to [`DETOURS_MAX`] in a window: a guest that exits without end fills
//! neither the ring nor anybody's memory.

use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::time::Tsc;

/// Most detours of one window that are recorded; the others are only counted.
pub const DETOURS_MAX: u32 = 16;

/// One entry of the ring. The detours of a window come before the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Record {
    /// The guest was left and entered again.
    Detour(Detour),
    /// A window is over.
    Window(WindowRecord),
}

/// An exit from the guest after which it was entered again in the same window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Detour {
    /// Why.
    pub exit: Exit,
    /// When the guest was left.
    pub left: Tsc,
    /// When it was entered again.
    pub entered: Tsc,
}

/// Why a guest was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// An access to this I/O port.
    Port(u16),
    /// An access to this address, where no memory is.
    Memory(u64),
    /// A signal.
    Signal,
    /// Anything else.
    Other,
}

/// When a guest says that it started and finished the scan of one release.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scan {
    /// Start of the scan.
    pub start: Tsc,
    /// Its end; earlier than `start` while the scan runs.
    pub done: Tsc,
}

/// One window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowRecord {
    /// Which release.
    pub sequence: u64,
    /// Under which schedule.
    pub schedule: ScheduleId,
    /// Releases before this one that were skipped because the host came too late for them.
    pub skipped: u64,
    /// Where the release lies.
    pub release: Tsc,
    /// Where the window ends.
    pub end: Tsc,
    /// When the thread was to wake up.
    pub due: Tsc,
    /// When it did.
    pub woken: Tsc,
    /// Last look at the clock before the guest was entered first.
    pub entered: Tsc,
    /// When the guest was left last.
    pub left: Tsc,
    /// When the window's end was enforced by a kick.
    pub kicked: Option<Tsc>,
    /// What the guest claims of this release; checked by [`WindowRecord::scan`].
    pub claim: Option<Scan>,
    /// The guest's last stamp of all, of whatever release: for a guest that stamps without end,
    /// the last moment at which it ran. A claim.
    pub last_stamp: Tsc,
    /// Exits from the guest to this thread, the last one included.
    pub exits: u32,
    /// Exits from the guest as KVM counts them, those that the host's kernel answered by itself
    /// (its own interrupts) included; 0 if KVM does not tell.
    pub kernel_exits: u64,
    /// True if the window ended before the guest said that it was done.
    pub overrun: bool,
    /// True if the guest ended in this window, and does not go on.
    pub ended: bool,
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

/// For tests: of a window of 900 ns, which is left after 500, in each frame of 1000. One tick is one
/// nanosecond, and the epoch at tick 1000.
#[cfg(test)]
pub(crate) fn example(sequence: u64, latency: u64, execution: u64) -> WindowRecord {
    let release = 1_000 + 1_000 * sequence;
    let start = Tsc(release + latency);
    WindowRecord {
        sequence,
        schedule: ScheduleId(0),
        skipped: 0,
        release: Tsc(release),
        end: Tsc(release + 900),
        due: Tsc(release - 20),
        woken: Tsc(release - 10),
        entered: Tsc(release - 5),
        left: Tsc(release + 500),
        kicked: None,
        claim: Some(Scan { start, done: Tsc(start.0 + execution) }),
        last_stamp: start,
        exits: 1,
        kernel_exits: 1,
        overrun: false,
        ended: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(release: u64, entered: u64, left: u64, start: u64) -> WindowRecord {
        WindowRecord {
            release: Tsc(release),
            entered: Tsc(entered),
            left: Tsc(left),
            claim: Some(Scan { start: Tsc(start), done: Tsc(0) }),
            ..example(0, 0, 0)
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
