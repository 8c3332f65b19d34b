//! What is said on the control socket. `docs/control.md` describes it byte by byte.
//!
//! The types are those of both sides, so that they cannot disagree. A request has two forms, as the
//! partition file has: [`Raw`] with every key that there is, and [`Request`], in which only what
//! makes sense can be said.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::boot::StartMode;
use crate::report::Summary;

/// Version of the protocol: the only value of `version` that is understood.
pub const VERSION: u32 = 1;
/// Longest line of a request in bytes, its newline included.
pub const LINE_MAX: usize = 64 * 1024;

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// How the run stands.
    Status,
    /// A partition shall stop.
    Stop(String),
    /// A partition that has stopped or ended shall start again.
    Start(String, Mode),
    /// A partition shall stop and start again.
    Restart(String, Mode),
    /// This schedule shall hold.
    Schedule(String),
    /// What has happened lately; and from now on, if it shall be followed.
    Events {
        /// True if the client wants every event that comes.
        follow: bool,
    },
}

/// How a partition is started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Nothing is kept.
    Cold,
    /// What the partition retains is kept.
    Warm,
}

impl From<Mode> for StartMode {
    fn from(mode: Mode) -> StartMode {
        match mode {
            Mode::Cold => StartMode::Cold,
            Mode::Warm => StartMode::Warm,
        }
    }
}

impl From<StartMode> for Mode {
    fn from(mode: StartMode) -> Mode {
        match mode {
            StartMode::Cold => Mode::Cold,
            StartMode::Warm => Mode::Warm,
        }
    }
}

/// A request as it is written.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    version: u32,
    request: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    partition: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mode: Option<Mode>,
    #[serde(skip_serializing_if = "Option::is_none")]
    schedule: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    follow: Option<bool>,
}

impl Request {
    /// Reads a line.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(line: &[u8]) -> Result<Request, Refusal> {
        let malformed = |error: serde_json::Error| {
            Refusal::new(ErrorKind::Malformed, format!("this is no request: {error}"))
        };
        let value: Value = serde_json::from_slice(line).map_err(malformed)?;
        if !value.is_object() {
            let text = "this is no request: it must be a JSON object";
            return Err(Refusal::new(ErrorKind::Malformed, text));
        }
        // Before all else: of another version nothing else is known.
        if value.get("version").and_then(Value::as_u64) != Some(u64::from(VERSION)) {
            let text = format!("`version` must be {VERSION}");
            return Err(Refusal::new(ErrorKind::Version, text));
        }
        Raw::deserialize(value).map_err(malformed)?.check()
    }

    /// The line of this request, with its newline.
    #[must_use]
    pub fn line(&self) -> Vec<u8> {
        let raw =
            |request: &str| Raw { version: VERSION, request: request.to_owned(), ..Raw::default() };
        let of = |request, partition: &String| Raw {
            partition: Some(partition.clone()),
            ..raw(request)
        };
        line(&match self {
            Request::Status => raw("status"),
            Request::Stop(partition) => of("stop", partition),
            Request::Start(partition, mode) => Raw { mode: Some(*mode), ..of("start", partition) },
            Request::Restart(partition, mode) => {
                Raw { mode: Some(*mode), ..of("restart", partition) }
            }
            Request::Schedule(name) => Raw { schedule: Some(name.clone()), ..raw("schedule") },
            Request::Events { follow } => Raw { follow: Some(*follow), ..raw("events") },
        })
    }
}

impl Raw {
    fn check(self) -> Result<Request, Refusal> {
        let Raw { version: _, request, partition, mode, schedule, follow } = self;
        let given = [partition.is_some(), mode.is_some(), schedule.is_some(), follow.is_some()];
        let missing = |key: &str| {
            Refusal::new(ErrorKind::Malformed, format!("\"{request}\" needs the key `{key}`"))
        };
        let named = |name: Option<String>, key: &str| name.ok_or_else(|| missing(key));
        let (checked, allowed) = match request.as_str() {
            "status" => (Request::Status, [false; 4]),
            "stop" => (Request::Stop(named(partition, "partition")?), [true, false, false, false]),
            "start" => {
                let mode = mode.unwrap_or(Mode::Cold);
                (Request::Start(named(partition, "partition")?, mode), [true, true, false, false])
            }
            "restart" => {
                let mode = mode.ok_or_else(|| missing("mode"))?;
                (Request::Restart(named(partition, "partition")?, mode), [true, true, false, false])
            }
            "schedule" => {
                (Request::Schedule(named(schedule, "schedule")?), [false, false, true, false])
            }
            "events" => {
                (Request::Events { follow: follow == Some(true) }, [false, false, false, true])
            }
            _ => {
                let text = "`request` must be \"status\", \"stop\", \"start\", \"restart\", \
                            \"schedule\" or \"events\"";
                return Err(Refusal::new(ErrorKind::UnknownRequest, text));
            }
        };
        let keys = ["partition", "mode", "schedule", "follow"];
        let excess = keys.iter().zip(given).zip(allowed).find(|((_, given), ok)| *given && !ok);
        match excess {
            None => Ok(checked),
            Some(((key, _), _)) => {
                let text = format!("\"{request}\" does not take the key `{key}`");
                Err(Refusal::new(ErrorKind::Malformed, text))
            }
        }
    }
}

/// Why a request was not granted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// For programs.
    pub error: ErrorKind,
    /// For people.
    pub text: String,
}

impl Refusal {
    /// With a text.
    #[must_use]
    pub fn new(error: ErrorKind, text: impl Into<String>) -> Refusal {
        Refusal { error, text: text.into() }
    }
}

/// Kinds of refusals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorKind {
    /// No JSON object, or keys and values that do not fit the request.
    Malformed,
    /// A line of more than [`LINE_MAX`] bytes. The connection ends.
    TooLong,
    /// Another version of the protocol.
    Version,
    /// There is no such request.
    UnknownRequest,
    /// There is no such partition.
    NoSuchPartition,
    /// There is no such schedule.
    NoSuchSchedule,
    /// Not in this state, such as the start of a partition that runs.
    Refused,
    /// Never, for this partition.
    Unsupported,
    /// There are too many clients. The connection ends.
    Full,
}

/// A line from Takt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// [`VERSION`].
    pub version: u32,
    /// The rest.
    #[serde(flatten)]
    pub answer: Answer,
}

/// What Takt says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "answer", rename_all = "kebab-case")]
pub enum Answer {
    /// The order is accepted; how far it has got, `status` and the events tell.
    Done {
        /// For people.
        text: String,
    },
    /// To `status`.
    Status {
        /// How the run stands.
        status: Box<Status>,
    },
    /// To `events`.
    Events {
        /// The latest ones, the oldest first.
        events: Vec<Event>,
    },
    /// Unasked, to who follows.
    Event {
        /// What happened.
        event: Event,
    },
    /// The request changes nothing.
    Error(Refusal),
}

impl Answer {
    /// The line of this answer, with its newline.
    #[must_use]
    pub fn line(self) -> Vec<u8> {
        line(&Message { version: VERSION, answer: self })
    }
}

/// None of these types has a map with keys that are no text, which is all that could fail.
fn line(value: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(value).unwrap_or_default();
    line.push(b'\n');
    line
}

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
}

/// How a partition has kept its time, since the epoch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReleaseStatus {
    /// Releases that happened.
    pub happened: u64,
    /// Windows that the guest needed to start up.
    pub start_up_windows: u64,
    /// Releases that never happened.
    pub lost: u64,
    /// Releases that came later than the guard can absorb.
    pub late: u64,
    /// Windows that ended by a kick.
    pub overruns: u64,
    /// Sum of the latencies of all releases: from the difference of two answers follows the mean
    /// of the time between them.
    pub latency_sum_ns: u64,
    /// From the release to the guest's start.
    pub release_latency_ns: Option<Summary>,
    /// From the guest's start to its end.
    pub execution_ns: Option<Summary>,
    /// From when the thread was to wake up to when it did.
    pub wake_up_latency_ns: Option<Summary>,
}

/// Something that has happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Counts from 1, without gaps.
    pub sequence: u64,
    /// When it became known, since the epoch.
    pub at_ns: u64,
    /// What kind of event.
    pub kind: EventKind,
    /// Whose, if it is a partition's.
    pub partition: Option<String>,
    /// For people.
    pub text: String,
}

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A switch of the schedule has taken effect.
    Schedule,
    /// A partition has ended by itself, or could not be started anew.
    Ended,
    /// An operator has stopped a partition.
    Stopped,
    /// A partition was started anew.
    Restarted,
    /// The health monitor has taken note of an error.
    Health,
}
