//! What the command line adds to the partition file, and what only tests ask for.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::appliance::Role;
use crate::sandbox;

/// What the command line adds to the partition file.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// What this process is to the appliance.
    pub role: Role,
    /// End by itself after this time.
    pub duration: Option<Duration>,
    /// When Takt began, for the report.
    pub began: Option<Instant>,
    /// Write the report here as JSON.
    pub report: Option<PathBuf>,
    /// Write a trace of every window here.
    pub trace: Option<PathBuf>,
    /// Write the samples of the releases here as JSON.
    pub samples: Option<PathBuf>,
    /// Where the control socket is, instead of what the partition file says.
    pub control: Option<PathBuf>,
    /// How Takt was started, for the report.
    pub lane: String,
    /// What emulates the machine, for the report.
    pub emulator: Option<String>,
    /// For tests: windows are not ended by kicks, so that only SCHED_DEADLINE is left.
    pub without_kick: bool,
    /// For tests: a thread panics after this time.
    pub panic_after: Option<Duration>,
    /// For tests: the wake-ups for the release of this number come late.
    pub late_wake_up: Option<u64>,
    /// What follows from a system call that a thread may not make.
    pub seccomp: sandbox::Mode,
    /// For tests: the thread that makes such a call, a second after the start.
    pub provoke: Option<String>,
    /// For tests: the step of the start after which it fails, from 1 on.
    pub fail_at: Option<u32>,
}
