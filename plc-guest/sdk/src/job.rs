//! What a task is told about its job.

use core::time::Duration;

/// The page that the kernel fills before each job, 64 bytes.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Job {
    /// Version of the interface: 1.
    pub version: u32,
    /// The task's number; `u32::MAX` in `init`.
    pub task: u32,
    /// Jobs of this task that were released before this one.
    pub cycle: u64,
    /// The scheduled release: nanoseconds since the partition's start.
    pub now_ns: u64,
    /// Nanoseconds since this task's last release; 0 in its first job.
    pub period_ns: u64,
    /// 0 after a cold start, 1 after a warm one.
    pub start: u32,
    /// Zero in this version.
    pub flags: u32,
    /// Zero in this version.
    pub reserved: [u64; 3],
}

impl Job {
    /// Seconds since this task's last release; 0 in its first job.
    #[must_use]
    pub fn elapsed(&self) -> f64 {
        self.period_ns as f64 * 1e-9
    }

    /// The time since this task's last release, as function blocks want it; 0 in its first job.
    #[must_use]
    pub const fn interval(&self) -> Duration {
        Duration::from_nanos(self.period_ns)
    }

    /// Whether it is the task's first job since the program's start.
    #[must_use]
    pub const fn is_first(&self) -> bool {
        self.cycle == 0
    }

    /// Whether RETAIN variables have the values from before the stop.
    #[must_use]
    pub const fn is_warm_start(&self) -> bool {
        self.start == 1
    }
}

/// The number of a job: that of its task, and in the lower bits that of its release. Never 0.
#[cfg(not(test))]
pub(crate) fn running() -> u64 {
    let stack: usize;
    // SAFETY: reads a register.
    unsafe {
        core::arch::asm!("mov {}, rsp", out(reg) stack, options(nomem, nostack, preserves_flags))
    }
    let task = (stack - STACKS) / STACK_SLOT;
    number(task as u64 + 1, cycle(task))
}

/// Whether a job that had begun was ended before its time: a later one of its task has begun, or is the running one.
pub(crate) fn is_abandoned(job: u64, running: u64) -> bool {
    let task = job >> RELEASE_BITS;
    let latest = if task == running >> RELEASE_BITS {
        running
    } else {
        number(task, cycle(task as usize - 1))
    };
    latest != job
}

/// Bits for the number of the release: enough for centuries.
const RELEASE_BITS: u32 = 48;

/// Tasks count from 1 here.
fn number(task: u64, release: u64) -> u64 {
    task << RELEASE_BITS | release & ((1 << RELEASE_BITS) - 1)
}

/// Where stacks begin, one for each task, and how far they are apart; where the tasks' [`Job`]s are. As in docs/program-image.md.
#[cfg(not(test))]
const STACKS: usize = 0x6000_0000;
#[cfg(not(test))]
const STACK_SLOT: usize = 0x10_0000;
#[cfg(not(test))]
const JOBS: usize = 0x6fff_f000;

/// The number of the release of a task's latest job.
#[cfg(not(test))]
fn cycle(task: usize) -> u64 {
    let job = (JOBS as *const Job).wrapping_add(task);
    // SAFETY: the kernel has mapped the page for all tasks that there can be, and writes whole words.
    unsafe { core::ptr::read_volatile(&raw const (*job).cycle) }
}

#[cfg(test)]
pub(crate) use pretended::{cycle, pretend, running};

/// Tasks of a test.
#[cfg(test)]
mod pretended {
    use std::cell::RefCell;

    std::thread_local! {
        static TASKS: RefCell<(usize, std::vec::Vec<(usize, u64)>)> = const { RefCell::new((0, std::vec::Vec::new())) };
    }

    /// From here on this task runs, and tasks are in these releases.
    pub fn pretend(task: usize, releases: &[(usize, u64)]) {
        TASKS.set((task, releases.to_vec()));
    }

    pub fn running() -> u64 {
        let task = TASKS.with_borrow(|tasks| tasks.0);
        super::number(task as u64 + 1, cycle(task))
    }

    pub fn cycle(task: usize) -> u64 {
        TASKS.with_borrow(|tasks| {
            tasks.1.iter().find(|(known, _)| *known == task).map_or(0, |known| known.1)
        })
    }
}
