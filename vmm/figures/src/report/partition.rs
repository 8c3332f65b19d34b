//! What a report tells of one partition.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Deserializer, Serialize};

use super::{Net, Operator, PowerOff, Summary, Vsock, WakeUps};
use crate::worst::{LateStart, LongScan};

/// How a partition ended that ran until the end of the run.
pub const STOPPED: &str = "stopped by takt";

/// One partition.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Partition {
    /// Its name.
    pub name: String,
    /// `plc` or `linux`.
    pub kind: Cow<'static, str>,
    /// How it ended.
    pub end: String,
    /// True if it ended by a failure of its own.
    pub failed: bool,
    /// Size of the host's pages of which its memory is made, in bytes.
    #[serde(default)]
    pub memory_page_bytes: u64,
    /// How often its guest was started anew.
    pub restarts: u64,
    /// CPU time of its thread, as a part of the run's duration.
    pub cpu_share: f64,
    /// Its errors.
    pub events: Events,
    /// Its illegal requests: mostly accesses to ports and memory that nothing answers.
    pub illegal_accesses: u64,
    /// Bytes of console output that were dropped.
    pub console_dropped: u64,
    /// Only for partitions with windows and a scan.
    #[serde(flatten)]
    pub releases: Option<Releases>,
    /// Only for partitions with windows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wake_ups: Option<WakeUps>,
    /// Only for a background partition.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub donation: Option<Donation>,
    /// Only for a Linux beside windows on its CPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadlines: Option<Deadlines>,
    /// That a Linux was asked to switch itself off at the end of the run; left out if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power_off: Option<PowerOff>,
    /// What operators did with a PLC's values; left out if they did nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<Operator>,
    /// The network interfaces of a Linux.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nets: Vec<Net>,
    /// The socket device of a Linux.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vsock: Option<Vsock>,
    /// That a program of the host kept interfaces or sockets of a Linux from being closed at the end; left out if none did.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub held_up: bool,
    /// Only for Linux: from the start of its vCPU to its first process; `null` if it did not get
    /// there, or if its console does not show the kernel's messages.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "null_or")]
    pub boot_to_init_ns: Option<Option<u64>>,
    /// Only for Linux: that its kernel did nothing any more when the run ended; `null` if nothing
    /// is known that speaks for it.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "null_or")]
    pub stuck: Option<Option<Stuck>>,
}

/// A key that is there: `null` is a value of its own, which serde takes for a key that is not.
fn null_or<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<Option<T>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// How a partition kept its time.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Releases {
    /// Releases that happened.
    pub releases: u64,
    /// Windows that the guest needed to start up, before its first scan, those that the host slept through included.
    pub start_up_windows: u64,
    /// Releases that never happened, whether the guest's thread or the guest was not there for them.
    pub lost: u64,
    /// Wake-ups that came later than the guard can absorb: their releases were late, or lost as well.
    pub late_releases: u64,
    /// Windows that ended by a kick before the guest's scan was complete.
    pub overruns: u64,
    /// Windows that ended by a kick after the scan, while lesser tasks of the guest went on.
    pub unfinished_windows: u64,
    /// Windows that are in none of these figures because the supervisor thread could not keep up.
    pub unrecorded: u64,
    /// From the release to the guest's start.
    pub release_latency_ns: Option<Summary>,
    /// From the guest's start to its end.
    pub execution_ns: Option<Summary>,
    /// From when the thread was to wake up to when it did, also where the window was over by then.
    pub wake_up_latency_ns: Option<Summary>,
    /// The release guard: how long before each release the thread was to wake up.
    #[serde(default)]
    pub release_guard_ns: Option<Summary>,
    /// From the wake-up to the last look at the clock before the guest.
    pub entry_ns: Option<Summary>,
    /// From the end of the scan to the thread's being out of the guest; not for a guest with tasks that
    /// may run in between.
    pub exit_ns: Option<Summary>,
    /// In overruns, from the window's end to the guest's last time stamp: its own claim of when
    /// it last ran.
    pub overrun_ns: Option<Summary>,
    /// Where a kick ended a window, from that end to the thread's being out of the guest.
    pub kick_ns: Option<Summary>,
    /// Exits from the guest in a window, as KVM counts them: those of the guest's own doing, and
    /// those of the host's interrupts. Not a time. `None` if KVM does not tell.
    pub vm_exits: Option<Summary>,
    /// The releases that started latest, and why; those that were on time are left out.
    pub late_starts: Vec<LateStart>,
    /// The scans that took longest, and why.
    pub longest_scans: Vec<LongScan>,
}

/// What a background partition was left, and what it got of that.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Donation {
    /// Time that no windowed partition of the CPU used, from its wake-up (the guard included) to
    /// its leaving the guest.
    pub offered_ns: u64,
    /// CPU time that the partition used. A guest that halts uses less than it is offered.
    pub received_ns: u64,
    /// The share of the CPU that is its own whatever the others do, by analysis.
    pub minimum_share: f64,
}

/// What became of the deadlines of a Linux's timer.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Deadlines {
    /// How often Linux has programmed its timer.
    pub programmed: u64,
    /// Deadlines that lay in a window or its guard, and were moved to its end.
    pub moved: u64,
    /// Of those: put back, since the PLC was done early or the schedule changed.
    pub put_back: u64,
}

/// The errors of a partition; see `docs/health.md`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Events {
    /// How often each error happened, those that are ignored included. What never did is left out.
    pub totals: BTreeMap<Cow<'static, str>, u64>,
    /// The first events.
    pub list: Vec<Event>,
    /// Events that are not in the list.
    pub unlisted: u64,
}

/// An error that was not ignored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Place among the events of the partition, from 1.
    pub sequence: u64,
    /// When it was seen, since the epoch.
    pub at_ns: u64,
    /// Which error.
    pub error: Cow<'static, str>,
    /// What is known of it.
    pub detail: String,
    /// What followed.
    pub action: Cow<'static, str>,
}

/// A kernel that does nothing any more; see `docs/health.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stuck {
    /// In which way.
    pub how: How,
    /// Since when it is known, from the epoch on.
    pub since_ns: u64,
}

/// In which way a kernel does nothing any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum How {
    /// It uses the processor, and takes no interrupt since it has switched them off.
    Spinning,
    /// It uses the processor, and takes no interrupt though it has not switched them off.
    Deaf,
    /// It has halted with interrupts off: nothing wakes it.
    Halted,
    /// Its console says that it has panicked.
    Panicked,
}

impl fmt::Display for Stuck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self.how {
            How::Spinning => "spins with interrupts off",
            How::Deaf => "spins and gets no interrupt",
            How::Halted => "has halted with interrupts off",
            How::Panicked => "has panicked, as its console says,",
        };
        write!(f, "{what} since {:.3} s", self.since_ns as f64 / 1e9)
    }
}
