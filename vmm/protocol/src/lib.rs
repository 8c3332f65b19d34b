//! What is said on the control socket. `docs/control.md` describes it byte by byte.
//!
//! The types are those of both sides, so that they cannot disagree.

mod answer;
mod console;
mod hex;
mod point;
mod request;
mod status;

use serde::Serialize;
use takt_scheduler::time::Nanos;

pub use answer::{
    Answer, ErrorKind, Event, EventKind, ImageVersion, Message, Refusal, VersionStatus,
};
pub use console::{ConsoleOutput, ConsoleStart, TYPED_MAX};
pub use hex::{from_hex, hex};
pub use point::{ForcedStatus, INTERVAL_MAX, LABEL_MAX, Named, Values, raw_point, raw_range};
pub use request::{Load, Mode, PART_MAX, PointValue, Request};
pub use status::{
    ChannelStatus, Contents, PartitionStatus, ProgramState, ProgramStatus, ReleaseStatus,
    ScheduleStatus, State, Status, TaskState, TaskStatus, WindowStatus,
};
pub use takt_abi::live::{Area, Point, Range, WATCHED_RANGES};
pub use takt_record::{
    ClaimedScan, ExitKind, TraceStart, TracedDetour, TracedPartition, TracedWindow,
};

/// Version of the protocol: the only value of `version` that is understood.
pub const VERSION: u32 = 2;
/// Longest line of a request in bytes, its newline included.
pub const LINE_MAX: usize = 64 * 1024;
/// Longest time for which a client can ask for a trace.
pub const TRACE_MAX: Nanos = Nanos::from_millis(60_000);

/// None of these types has a map with keys that are no text, which is all that could fail.
fn line(value: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(value).unwrap_or_default();
    line.push(b'\n');
    line
}
