//! What a task is told about its job.

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

    /// Whether RETAIN variables have the values from before the stop.
    #[must_use]
    pub const fn is_warm_start(&self) -> bool {
        self.start == 1
    }
}
