//! What a report tells of a Linux that was asked to switch itself off.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A request at the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PowerOff {
    /// When it was asked, since the epoch.
    pub asked_ns: u64,
    /// How long it took to switch itself off; `null` if it did not: it was stopped, or ended in another way.
    pub took_ns: Option<u64>,
}

impl fmt::Display for PowerOff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.took_ns {
            Some(ns) => write!(f, "asked at the end, off by itself after {:.3} s", ns as f64 / 1e9),
            None => f.write_str(
                "asked at the end, did not switch itself off: its file systems may not be clean",
            ),
        }
    }
}
