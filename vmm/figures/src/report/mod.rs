//! What a run tells at its end: a table for people and the same as JSON for programs.
//!
//! The writer and the readers of a report share these types.

mod net;
mod operator;
mod partition;
mod power_off;
mod process;
mod table;
mod tick;
mod wake_ups;

use serde::{Deserialize, Serialize};

pub use net::{Net, Traffic, Vsock};
pub use operator::{Forced, Operator};
pub use partition::{Deadlines, Donation, Event, Events, How, Partition, Releases, STOPPED, Stuck};
pub use power_off::PowerOff;
pub use process::{Footprint, Process, Starting};
pub use tick::{Clear, Tick};
pub use wake_ups::{WakeUps, WindowEnforcer};

/// Version of the JSON form: grows with every change that a reader could stumble over.
pub const SCHEMA_VERSION: u32 = 3;

/// A whole report. Field names are the JSON keys; times are nanoseconds.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// How Takt was run; see `scripts/run`. It says what the times mean.
    pub lane: String,
    /// What emulates this machine, and which of its known faults are left in it, as the script that
    /// started it says; `null` for a machine that is not emulated.
    pub emulator: Option<String>,
    /// Where.
    pub host: Host,
    /// `name` of the partition file's system.
    pub system: String,
    /// The time-stamp counter at the epoch, from which all times count: a stamp that somebody else on
    /// the host took, as when he started Takt, can be compared with it.
    pub epoch_tsc: u64,
    /// From the epoch to the end of the run.
    pub duration_ns: u64,
    /// False if a test has switched off the kick at a window's end.
    pub kick: bool,
    /// How the host's tick lay to the windows.
    pub tick: Tick,
    /// Which schedule held at the end.
    pub schedule: Schedule,
    /// In the order of the partition file.
    pub partitions: Vec<Partition>,
    /// What ends windows, by its CPU.
    pub window_enforcers: Vec<WindowEnforcer>,
    /// The ends of channels that are Takt's own, in the order of the partition file.
    pub host_ports: Vec<HostPort>,
    /// What Takt itself held.
    pub process: Process,
    /// What of Takt's own output was lost.
    pub output: Output,
}

/// What of Takt's own output was lost, because it was not read or its disk did not keep up. What
/// partitions lost is told of each of them.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Output {
    /// Bytes of Takt's own lines for which there was no room.
    pub takt_dropped_bytes: u64,
    /// Bytes, of whomever, that were still not read at the end of the run or could not be written.
    pub unread_bytes: u64,
    /// Events that the trace has not got.
    pub trace_dropped_events: u64,
}

/// Where the schedule stood at the end.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Schedule {
    /// The schedule that held.
    pub current: String,
    /// The schedule that would have held next: another one while a switch was under way.
    pub next: String,
    /// When it began to hold, since the epoch; `null` if it always did.
    pub last_switch_ns: Option<u64>,
}

/// The machine below Takt.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Host {
    /// Kernel release.
    pub kernel: String,
    /// True for a PREEMPT_RT kernel.
    pub preempt_rt: bool,
    /// Processor, as its kernel names it.
    pub cpu: String,
    /// Frequency of the time-stamp counter.
    pub tsc_khz: u32,
}

/// What became of the messages of an end on the host.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct HostPort {
    /// Name of the channel.
    pub channel: String,
    /// Name of the port.
    pub port: String,
    /// Messages that went through: packets to and from clients, or records.
    pub messages: u64,
    /// Messages that were overwritten before Takt took them.
    pub lost: u64,
    /// Claims of the channel's other end that cannot be true.
    pub hostile: u64,
    /// Connections that were closed at once, because there were too many.
    pub refused: u64,
    /// Clients that were let go of, because of what they sent.
    pub dropped: u64,
}

/// A distribution, in nanoseconds if it is one of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Summary {
    /// Smallest value, exact.
    pub min: u64,
    /// Median.
    pub p50: u64,
    /// 99 % of the values are at most this.
    pub p99: u64,
    /// 99.9 % of the values are at most this.
    pub p999: u64,
    /// Largest value, exact.
    pub max: u64,
}

#[cfg(test)]
mod tests;
