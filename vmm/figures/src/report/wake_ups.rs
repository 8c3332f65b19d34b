//! What a steered clock has done to a run: figures of the threads that sleep to instants of the
//! schedule.
//!
//! The kernel sleeps on a clock that NTP steers, and the schedule lies on the time-stamp counter;
//! [`takt_scheduler::sleep`] says what is done about it.

use std::fmt::Write;

use serde::{Deserialize, Serialize};
use takt_scheduler::sleep;

/// The thread that ends the windows of a CPU.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct WindowEnforcer {
    /// Which CPU.
    pub cpu: usize,
    /// How its wake-ups went.
    pub wake_ups: WakeUps,
}

/// How the wake-ups of a thread went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WakeUps {
    /// Made by the kernel before their instant, and corrected.
    pub early: u64,
    /// Between the pieces of divided sleeps.
    pub divided: u64,
    /// Sleeps before which the kernel's clock was found to be off by more than NTP's 500 ppm.
    pub steered: u64,
}

impl From<&sleep::WakeUps> for WakeUps {
    fn from(counted: &sleep::WakeUps) -> Self {
        Self { early: counted.early(), divided: counted.divided(), steered: counted.steered() }
    }
}

impl WakeUps {
    /// Tells what a steered clock has caused, and nothing where it was not: to divide a long sleep is
    /// a matter of course.
    pub(super) fn describe(self, text: &mut String) {
        if self.early > 0 || self.steered > 0 {
            let Self { early, steered, .. } = self;
            let _ = writeln!(
                text,
                "  clock steered  {early} early wake-ups corrected, {steered} sleeps with a clock that was off",
            );
        }
    }
}

impl WindowEnforcer {
    pub(super) fn describe(self, text: &mut String) {
        let mut told = String::new();
        self.wake_ups.describe(&mut told);
        if !told.is_empty() {
            let _ = write!(text, "\nwindow enforcer of CPU {}\n{told}", self.cpu);
        }
    }
}
