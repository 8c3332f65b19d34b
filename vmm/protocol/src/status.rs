//! How a run stands, as it is told.

use serde::{Deserialize, Serialize};

use super::{ForcedStatus, Mode};
use takt_figures::report::Summary;

/// How the run stands. Times are nanoseconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Version of Takt.
    pub takt: String,
    /// Its process.
    pub pid: u32,
    /// `name` of the partition file's system.
    pub system: String,
    /// The partition file.
    pub file: String,
    /// Since the epoch.
    pub uptime_ns: u64,
    /// Length of the major frame.
    pub major_frame_ns: u64,
    /// Which schedule holds.
    pub schedule: ScheduleStatus,
    /// In the order of the partition file.
    pub partitions: Vec<PartitionStatus>,
    /// In the order of the partition file.
    pub channels: Vec<ChannelStatus>,
}

/// Where the schedule stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScheduleStatus {
    /// All there are, in the order of the partition file.
    pub names: Vec<String>,
    /// The one that holds.
    pub current: String,
    /// The one that will hold: another one while a switch is under way.
    pub next: String,
    /// When the current one began to hold, since the epoch; `null` if it always did.
    pub last_switch_ns: Option<u64>,
    /// Windows of the current one, by CPU and then in the order of time.
    pub windows: Vec<WindowStatus>,
    /// Windows that are not among those.
    pub windows_left_out: u64,
}

/// A window of the frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WindowStatus {
    /// Whose it is.
    pub partition: String,
    /// From the start of the frame.
    pub offset_ns: u64,
    /// Its length.
    pub duration_ns: u64,
}

/// What a partition is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It runs.
    Running,
    /// It was asked to stop, and has not yet.
    Stopping,
    /// It was asked to start again, and has not yet.
    Restarting,
    /// An operator has stopped it.
    Stopped,
    /// It has ended.
    Ended,
}

/// How a partition stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartitionStatus {
    /// Its name.
    pub name: String,
    /// `plc` or `linux`.
    pub kind: String,
    /// The CPU that it runs on.
    pub cpu: u64,
    /// True if it has no windows and gets what those of others leave.
    pub background: bool,
    /// What it is doing.
    pub state: State,
    /// How it was started last.
    pub start_mode: Mode,
    /// How it ended; `null` while it runs.
    pub end: Option<String>,
    /// How often it was started anew.
    pub restarts: u64,
    /// CPU time of its thread.
    pub cpu_time_ns: u64,
    /// The same as a part of the time since the epoch.
    pub cpu_share: f64,
    /// Accesses that nothing answers.
    pub illegal_accesses: u64,
    /// Bytes of console output that were dropped.
    pub console_dropped: u64,
    /// Only for a partition with windows and a scan.
    pub releases: Option<ReleaseStatus>,
    /// In the order of the partition file.
    #[serde(default)]
    pub programs: Vec<ProgramStatus>,
    /// Values that operators keep forced, in the order in which they were forced.
    #[serde(default)]
    pub forced: Vec<ForcedStatus>,
}

/// How a program stands, as the PLC's kernel has said at most a second ago.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProgramStatus {
    /// Its name in the partition.
    pub name: String,
    /// What it does; `null` before the kernel has said so.
    pub state: Option<ProgramState>,
    /// SHA-256 of the image that runs, in hexadecimal digits; `null` before the kernel has said so.
    pub image: Option<String>,
    /// In the order of the image, after the initialisation if there is one.
    pub tasks: Vec<TaskStatus>,
}

/// What a program does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProgramState {
    /// It does not run.
    Stopped,
    /// It is initialised.
    Starting,
    /// Its tasks are released.
    Running,
    /// An error has stopped it.
    Faulted,
}

/// How a task stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskStatus {
    /// Its name in the image; `init` is the initialisation.
    pub name: String,
    /// What it does.
    pub state: TaskState,
    /// Complete jobs.
    pub jobs: u64,
    /// Jobs that were not complete at their deadline.
    pub missed: u64,
    /// Releases that were lost.
    pub overruns: u64,
    /// Jobs that were ended by the kernel.
    pub skipped: u64,
    /// Shortest execution of a job; `null` before the first.
    pub execution_min_ns: Option<u64>,
    /// Longest execution of a job.
    pub execution_max_ns: u64,
    /// Execution of all jobs: two answers give its share of the time between them.
    pub execution_sum_ns: u64,
    /// Longest time from a release to the end of its job.
    pub response_max_ns: u64,
    /// Longest time from a release to the start of its job.
    pub start_max_ns: u64,
    /// Shortest time from a job's end to its deadline; `null` without a deadline.
    pub slack_min_ns: Option<u64>,
    /// Times that the processor was given to it.
    pub switches: u64,
}

/// What a task does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TaskState {
    /// Its program does not run.
    Dormant,
    /// It waits for its next release, or in a call.
    Waiting,
    /// It has a job to do.
    Ready,
    /// It has stopped its program by an error.
    Faulted,
}

/// How a partition has kept its time, since the epoch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReleaseStatus {
    /// Releases that happened.
    pub happened: u64,
    /// Windows that the guest needed to start up, those that the host slept through included.
    pub start_up_windows: u64,
    /// Releases that never happened.
    pub lost: u64,
    /// Windows for whose records Takt had no room: the figures here lack them.
    #[serde(default)]
    pub unrecorded: u64,
    /// Wake-ups that came later than the guard can absorb: their releases were late, or lost as well.
    pub late: u64,
    /// Windows that ended by a kick before the scan was complete.
    pub overruns: u64,
    /// Windows that ended by a kick after it, while tasks went on.
    pub unfinished_windows: u64,
    /// Sum of the latencies of all releases: from the difference of two answers follows the mean
    /// of the time between them.
    pub latency_sum_ns: u64,
    /// From the release to the guest's start.
    pub release_latency_ns: Option<Summary>,
    /// From the guest's start to its end.
    pub execution_ns: Option<Summary>,
    /// From when the thread was to wake up to when it did, also where the window was over by then.
    pub wake_up_latency_ns: Option<Summary>,
}

/// How a channel stands at this moment, by what its ends claim.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelStatus {
    /// Its name.
    pub name: String,
    /// `sampling` or `queuing`.
    pub kind: String,
    /// Who sends, as `OWNER:PORT`.
    pub source: String,
    /// Who receives, in the same form.
    pub destinations: Vec<String>,
    /// Most messages that can wait; only of a queue.
    pub depth: Option<u64>,
    /// How long a message is valid; only of a sampling channel.
    pub refresh_ns: Option<u64>,
    /// What is in it; `null` if that cannot be told, for which `problem` has the reason.
    pub contents: Option<Contents>,
    /// Messages that were overwritten before they were taken; only where Takt itself takes them,
    /// since other destinations keep that to themselves.
    pub lost: Option<u64>,
    /// Why `contents` is `null`.
    pub problem: Option<String>,
}

/// What is in a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contents {
    /// Messages since the source was opened last.
    pub written: u64,
    /// Messages that wait; only of a queue.
    pub waiting: Option<u64>,
    /// Messages that were overwritten, which the destination has yet to notice; only of a queue.
    pub overwritten: Option<u64>,
    /// Age of the newest message, if there is one; 0 for a stamp in the future.
    pub age_ns: Option<u64>,
    /// Whether that is at most the refresh period; only of a sampling channel.
    pub valid: Option<bool>,
}
