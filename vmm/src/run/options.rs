//! What the command line adds to the partition file.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::appliance::Role;
use crate::config;
use crate::hooks::Hooks;
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
    /// What follows from a system call that a thread may not make.
    pub seccomp: sandbox::Mode,
    /// What only tests ask for.
    pub hooks: Hooks,
}

/// A time on the command line, such as `10s`.
///
/// # Errors
/// What is wrong with it, for people.
pub fn duration(text: &str) -> Result<Duration, String> {
    config::parse_duration(text).map(|ns| Duration::from_nanos(ns.0)).map_err(|e| e.to_string())
}
