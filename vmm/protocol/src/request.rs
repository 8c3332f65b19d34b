//! What a client may ask for.
//!
//! A request has two forms, as the partition file has: [`Raw`] with every key that there is, and
//! [`Request`], in which only what makes sense can be said.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use takt_scheduler::time::Nanos;

use super::{ErrorKind, Refusal, TRACE_MAX, VERSION, line};

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
    /// Every window from now on, for this long: more than nothing, at most [`TRACE_MAX`].
    Trace(Nanos),
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
    #[serde(skip_serializing_if = "Option::is_none")]
    duration_ns: Option<u64>,
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
            Request::Trace(duration) => Raw { duration_ns: Some(duration.0), ..raw("trace") },
        })
    }
}

impl Raw {
    fn check(self) -> Result<Request, Refusal> {
        let Raw { version: _, request, partition, mode, schedule, follow, duration_ns } = self;
        let given = [
            ("partition", partition.is_some()),
            ("mode", mode.is_some()),
            ("schedule", schedule.is_some()),
            ("follow", follow.is_some()),
            ("duration_ns", duration_ns.is_some()),
        ];
        let malformed = |text| Refusal::new(ErrorKind::Malformed, text);
        let missing = |key: &str| malformed(format!("\"{request}\" needs the key `{key}`"));
        let named = |name: Option<String>, key: &str| name.ok_or_else(|| missing(key));
        let (checked, allowed): (Request, &[&str]) = match request.as_str() {
            "status" => (Request::Status, &[]),
            "stop" => (Request::Stop(named(partition, "partition")?), &["partition"]),
            "start" => {
                let mode = mode.unwrap_or(Mode::Cold);
                (Request::Start(named(partition, "partition")?, mode), &["partition", "mode"])
            }
            "restart" => {
                let mode = mode.ok_or_else(|| missing("mode"))?;
                (Request::Restart(named(partition, "partition")?, mode), &["partition", "mode"])
            }
            "schedule" => (Request::Schedule(named(schedule, "schedule")?), &["schedule"]),
            "events" => (Request::Events { follow: follow == Some(true) }, &["follow"]),
            "trace" => {
                let duration = Nanos(duration_ns.ok_or_else(|| missing("duration_ns"))?);
                if duration == Nanos::ZERO || duration > TRACE_MAX {
                    return Err(malformed(format!("`duration_ns` must be 1 to {}", TRACE_MAX.0)));
                }
                (Request::Trace(duration), &["duration_ns"])
            }
            _ => {
                let text = "`request` must be \"status\", \"stop\", \"start\", \"restart\", \
                            \"schedule\", \"events\" or \"trace\"";
                return Err(Refusal::new(ErrorKind::UnknownRequest, text));
            }
        };
        match given.iter().find(|(key, given)| *given && !allowed.contains(key)) {
            None => Ok(checked),
            Some((key, _)) => {
                Err(malformed(format!("\"{request}\" does not take the key `{key}`")))
            }
        }
    }
}
