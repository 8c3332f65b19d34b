//! What Takt says: answers, refusals and events.

use serde::{Deserialize, Serialize};

use super::console::{ConsoleOutput, ConsoleStart};
use super::{Status, TraceStart, TracedWindow, VERSION, Values, line};

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
    /// A line of more than [`LINE_MAX`](crate::LINE_MAX) bytes. The connection ends.
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
    /// To `trace`.
    Trace {
        /// What is needed to understand what comes.
        trace: TraceStart,
    },
    /// Unasked, to who traces: a window is over.
    Window {
        /// Which.
        window: TracedWindow,
    },
    /// Unasked, to who traces: another schedule holds.
    Switch {
        /// From when on.
        at_tsc: u64,
        /// Which.
        schedule: String,
    },
    /// Unasked, to who traces: the time is over.
    Traced {
        /// Windows that the client was told of.
        windows: u64,
        /// Windows that it was not told of, because it did not read fast enough.
        dropped: u64,
    },
    /// To `watch`.
    Watching {
        /// Of this partition.
        partition: String,
        /// So many bytes in each line of values.
        bytes: u64,
    },
    /// Unasked, to who watches.
    Values {
        /// Of one cycle.
        values: Values,
    },
    /// To `versions`.
    Versions {
        /// Of each program, in the order of the partition file.
        versions: Vec<VersionStatus>,
    },
    /// To `attach`.
    Attached {
        /// What the console shows at the start.
        console: ConsoleStart,
    },
    /// Unasked, to who has attached to a console.
    Console {
        /// What its partition has written.
        console: ConsoleOutput,
    },
    /// To `type`.
    Typed {
        /// So many of the bytes were taken, the first ones. There was no room for the others.
        taken: u64,
    },
    /// The request changes nothing.
    Error(Refusal),
}

impl Answer {
    /// The same, if it grants the request.
    ///
    /// # Errors
    /// The refusal, if it is one.
    pub fn granted(self) -> Result<Answer, Refusal> {
        match self {
            Answer::Error(refusal) => Err(refusal),
            other => Ok(other),
        }
    }

    /// The line of this answer, with its newline.
    #[must_use]
    pub fn line(self) -> Vec<u8> {
        line(&Message { version: VERSION, answer: self })
    }
}

/// Which versions of a program there are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionStatus {
    /// Its name.
    pub program: String,
    /// The version that runs.
    pub running: ImageVersion,
    /// The one that is prepared, or that a roll-back leads to.
    pub other: Option<ImageVersion>,
    /// How far a change is: `none`, `preparing`, `prepared`, `committing`, `trial`, `held`, `rolling-back`,
    /// `rolled-back` or `refused`.
    pub phase: String,
    /// Why it is there; `null` if there is nothing to say.
    pub reason: Option<String>,
    /// Jobs that the version has done on trial.
    pub jobs: u64,
    /// References that became `NULL` at the last change.
    pub references_gone: u64,
    /// Time of the last change, from the last instruction before it to the last of it.
    pub took_ns: u64,
    /// When that was, since the start of the programs.
    pub at_ns: u64,
    /// Jobs of the first task up to then.
    pub cycle: u64,
    /// Pages that were carried to a second state for the last change, each as often as it was.
    #[serde(default)]
    pub carried_pages: u64,
    /// Time without a job that this took.
    #[serde(default)]
    pub carrying_ns: u64,
}

/// An image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageVersion {
    /// The author's version.
    pub version: String,
    /// SHA-256.
    pub hash: String,
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
    /// The release guard of a partition has another length.
    Guard,
    /// An operator has written a value.
    Written,
    /// An operator keeps a value forced.
    Forced,
    /// Values are not forced any more: an operator has released them, or their partition has started anew.
    Released,
    /// A program has changed to another version, or a change has got on.
    Change,
    /// What came of the retained values of a program: taken from a file, not written, and so on.
    Retained,
}
