//! What `takt probe --json` tells of the host's KVM: one JSON object on one line.

use serde::{Deserialize, Serialize};

/// Version of the form; grows with every change that a reader could stumble over.
pub const SCHEMA_VERSION: u32 = 2;

/// An examination of KVM.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Examination {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What was found.
    pub kvm: Found,
}

/// How much of KVM there is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum Found {
    /// `/dev/kvm` cannot be opened.
    Closed {
        /// The number of the error, as in errno(3).
        errno: i32,
    },
    /// It lacks what Takt needs.
    Lacking {
        /// Each thing by its name.
        missing: Vec<String>,
    },
    /// It has what Takt needs.
    Complete(Machines),
}

/// What machines on this KVM are like.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machines {
    /// Why there can be no machine for a PLC; `null` if there can.
    pub plc_error: Option<String>,
    /// Why there can be no machine for a Linux; `null` if there can.
    pub linux_error: Option<String>,
    /// How fast kernel-mode code of a guest runs.
    pub speed: Speed,
    /// Whether KVM leaves it to Takt where the deadlines of a Linux's timer go; `null` if that could
    /// not be found out.
    pub hands_deadlines_over: Option<bool>,
    /// Whether KVM tells of a guest's bus locks.
    pub tells_bus_locks: bool,
    /// Frequency of the time-stamp counter as KVM has it, in kHz; `null` if it does not tell.
    pub tsc_khz: Option<u32>,
}

/// How fast kernel-mode code of a guest runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum Speed {
    /// On the processor itself.
    Hardware {
        /// What was measured, for people.
        text: String,
    },
    /// By an emulator.
    Emulated {
        /// What was measured, for people.
        text: String,
    },
    /// No guest could run.
    Failed {
        /// Why.
        error: String,
    },
}
