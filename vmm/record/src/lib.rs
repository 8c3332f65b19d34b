//! What happened in a window: written on the PLC's path, read by another thread.
//!
//! The instants of a window are few and always the same, so they are one value of fixed size that
//! is pushed into a ring when the window is over. Only an exit that is *not* the window's last has
//! a record of its own, up to [`DETOURS_MAX`] in a window: a guest that exits without end fills
//! neither the ring nor anybody's memory.

mod window_assembler;
mod wire;

use takt_scheduler::guard::GuardChange;
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::time::Tsc;

pub use window_assembler::WindowAssembler;
pub use wire::{ClaimedScan, ExitKind, TraceStart, TracedDetour, TracedPartition, TracedWindow};

/// Most detours of one window that are recorded; the others are only counted.
pub const DETOURS_MAX: u32 = 16;

/// One entry of the ring. The detours of a window come before the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Record {
    /// The guest was left and entered again.
    Detour(Detour),
    /// A window is over.
    Window(WindowRecord),
    /// Releases have passed while the thread was not there.
    Skipped(Skipped),
    /// From the next window on the release guard has another length.
    Guard(GuardChange),
}

/// Releases in a row whose windows were over before the thread came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// How many.
    pub count: u64,
    /// When the thread was to wake up for the first of them.
    pub due: Tsc,
    /// When it did.
    pub woken: Tsc,
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
    /// Releases before this one that were skipped because the host came too late for them. Each of them was in a
    /// [`Skipped`] too, at once.
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
    /// True if the window ended before the guest said that it was done, and its scan is not complete.
    pub overrun: bool,
    /// True if the window ended before the guest said that it was done, but after its scan: tasks go on
    /// in the next one.
    pub unfinished: bool,
    /// True if the guest may do something else after its scan, before it says that it is done.
    pub has_tasks: bool,
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

    /// The same, if the scan ended before the guest was left.
    #[must_use]
    pub fn finished_scan(&self) -> Option<Scan> {
        self.scan().filter(|scan| (scan.start..=self.left).contains(&scan.done))
    }
}

#[cfg(any(test, feature = "example"))]
mod example;
#[cfg(any(test, feature = "example"))]
pub use example::example;

#[cfg(test)]
mod tests;
