//! What Takt's own process held, and how long it took to start.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What Takt's own process held when the guests started, and when the run was over.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Process {
    /// When the guests started; `null` if the host does not tell.
    pub start: Option<Footprint>,
    /// When the run was over.
    pub end: Option<Footprint>,
    /// How long it took to start them.
    pub starting: Starting,
}

/// How long a run took to start.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Starting {
    /// From the command to the epoch, the first release; `null` if it was not taken. The kernel's
    /// part, which loads Takt itself, is not in it.
    pub first_release_ns: Option<u64>,
    /// Of that: what it took to get and clear the guests' memory. In the appliance, huge pages are set aside for it
    /// first.
    pub clearing_ns: u64,
    /// Of that: what the epoch waited for its place to the host's tick, less than a frame.
    pub aligning_ns: u64,
}

impl fmt::Display for Starting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |ns: u64| ns as f64 / 1e6;
        write!(f, "guest memory cleared in {:.1} ms", ms(self.clearing_ns))?;
        match self.first_release_ns {
            Some(ns) => write!(f, ", first release {:.1} ms after the command", ms(ns))?,
            None => return Ok(()),
        }
        match self.aligning_ns {
            0 => Ok(()),
            ns => write!(f, ", {:.1} ms of them for its place to the host's tick", ms(ns)),
        }
    }
}

/// What is held at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Footprint {
    /// Resident anonymous memory, which the guests' is not (`RssAnon`, proc_pid_status(5)).
    pub anonymous_bytes: u64,
    /// Open descriptors.
    pub descriptors: u64,
}
