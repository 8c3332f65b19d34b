//! What a task is told about its job.

use crate::Nanoseconds;
use crate::code::codes;

codes! {
    /// How the program was started.
    pub enum Start: u32 {
        /// All variables have their initial values.
        Cold = 0,
        /// RETAIN variables have the values that they had before the stop.
        Warm = 1,
    }
}

/// 64 bytes at [`address::task_information`](crate::address::task_information): each task has its own. A function finds
/// them by its argument, and code without it by the slot of its stack.
///
/// The kernel writes it before each job; a program can only read it. The argument of `init` and of
/// each task's function points to it. All fields are native numbers of x86-64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct TaskInformation {
    /// [`ABI_VERSION`](crate::ABI_VERSION).
    pub version: u32,
    /// The task's number, in the order of the image's task table. In `init`: `u32::MAX`.
    pub task: u32,
    /// Jobs of this task that were released before this one, since the program's start.
    pub cycle: u64,
    /// The scheduled release of this job: nanoseconds since the partition's start.
    pub now: u64,
    /// Nanoseconds since this task's last release; 0 in its first job.
    pub period: u64,
    /// A [`Start`] as a number.
    pub start: u32,
    /// Zero in this version.
    pub flags: u32,
    /// Zero in this version.
    pub reserved: [u64; 3],
}

impl TaskInformation {
    /// The `task` field while `init` runs.
    pub const INIT: u32 = u32::MAX;

    /// The scheduled release of this job, since the partition's start.
    #[must_use]
    pub const fn now(&self) -> Nanoseconds {
        Nanoseconds(self.now)
    }
}

const _: () = assert!(size_of::<TaskInformation>() == 64);
