//! What a client may ask for.
//!
//! A request has two forms, as the partition file has: [`Raw`] with every key that there is, and
//! [`Request`], in which only what makes sense can be said.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use takt_scheduler::time::Nanos;

use super::console::TYPED_MAX;
use super::hex::{from_hex, hex};
use super::point::{self, INTERVAL_MAX, LABEL_MAX, Named, raw_point, raw_range};
use super::{ErrorKind, Point, Range, Refusal, TRACE_MAX, VERSION, WATCHED_RANGES, line};

/// What a client asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Whether Takt is there: it answers in its next turn.
    Ping,
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
    /// The bytes of these ranges, of one cycle each time; none ends it.
    Watch {
        /// Whose.
        partition: String,
        /// Of which programs, and where.
        ranges: Vec<Range>,
        /// Least time from one line of values to the next; zero: each cycle.
        interval: Nanos,
    },
    /// A value shall be written once.
    Write(PointValue),
    /// A value shall be kept from now on.
    Force(PointValue),
    /// A value shall be kept no longer; no point: none of the partition.
    Release(String, Option<Point>),
    /// A part of an image: the next version of a program.
    Load(Load),
    /// A program of a partition shall change to the version that is prepared.
    Commit(String, String),
    /// A program of a partition shall change back.
    RollBack(String, String),
    /// Which versions the programs of a partition have.
    Versions(String),
    /// What a partition has written last, and from now on writes, to its console.
    Attach(String),
    /// Bytes for the console of a partition: 1 to [`TYPED_MAX`].
    Type(String, Vec<u8>),
}

/// A value for a point.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PointValue {
    /// Whose.
    pub partition: String,
    /// Where.
    pub point: Point,
    /// Little-endian; of a bit, bit 0.
    pub value: u64,
    /// For people.
    pub named: Named,
}

/// A part of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Load {
    /// Whose program.
    pub partition: String,
    /// Which one.
    pub program: String,
    /// Which part: from 0 on, in their order.
    pub part: u32,
    /// How many parts there are.
    pub parts: u32,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// Most bytes in one part.
pub const PART_MAX: usize = 24 * 1024;

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
    #[serde(skip_serializing_if = "Option::is_none")]
    ranges: Option<Vec<[u32; 4]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    interval_ns: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    point: Option<[u32; 5]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    text: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    program: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    part: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    parts: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<String>,
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

    /// Whether it changes something, or shows what a guest writes to its console. Else it asks how the run stands.
    #[must_use]
    pub const fn orders(&self) -> bool {
        match self {
            Request::Ping | Request::Status | Request::Events { .. } | Request::Trace(_) => false,
            Request::Watch { .. } | Request::Versions(_) => false,
            Request::Stop(_) | Request::Start(..) | Request::Restart(..) => true,
            Request::Schedule(_) | Request::Attach(_) | Request::Type(..) => true,
            Request::Write(_) | Request::Force(_) | Request::Release(..) => true,
            Request::Load(_) | Request::Commit(..) | Request::RollBack(..) => true,
        }
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
            Request::Ping => raw("ping"),
            Request::Status => raw("status"),
            Request::Stop(partition) => of("stop", partition),
            Request::Start(partition, mode) => Raw { mode: Some(*mode), ..of("start", partition) },
            Request::Restart(partition, mode) => {
                Raw { mode: Some(*mode), ..of("restart", partition) }
            }
            Request::Schedule(name) => Raw { schedule: Some(name.clone()), ..raw("schedule") },
            Request::Events { follow } => Raw { follow: Some(*follow), ..raw("events") },
            Request::Trace(duration) => Raw { duration_ns: Some(duration.0), ..raw("trace") },
            Request::Watch { partition, ranges, interval } => Raw {
                ranges: Some(ranges.iter().map(|range| raw_range(*range)).collect()),
                interval_ns: Some(interval.0),
                ..of("watch", partition)
            },
            Request::Write(value) => value.raw(of("write", &value.partition)),
            Request::Force(value) => value.raw(of("force", &value.partition)),
            Request::Release(partition, point) => {
                Raw { point: point.map(raw_point), ..of("release", partition) }
            }
            Request::Load(load) => Raw {
                program: Some(load.program.clone()),
                part: Some(load.part),
                parts: Some(load.parts),
                data: Some(hex(&load.data)),
                ..of("load", &load.partition)
            },
            Request::Commit(partition, program) => {
                Raw { program: Some(program.clone()), ..of("commit", partition) }
            }
            Request::RollBack(partition, program) => {
                Raw { program: Some(program.clone()), ..of("roll-back", partition) }
            }
            Request::Versions(partition) => of("versions", partition),
            Request::Attach(partition) => of("attach", partition),
            Request::Type(partition, bytes) => {
                Raw { data: Some(hex(bytes)), ..of("type", partition) }
            }
        })
    }
}

impl Raw {
    fn check(self) -> Result<Request, Refusal> {
        let Raw { version: _, request, partition, mode, schedule, follow, duration_ns, .. } = &self;
        let (partition, schedule) = (partition.clone(), schedule.clone());
        let (mode, follow, duration_ns) = (*mode, *follow, *duration_ns);
        let (program, part, parts) = (self.program.clone(), self.part, self.parts);
        let data = self.data.as_deref();
        let given = [
            ("partition", partition.is_some()),
            ("mode", mode.is_some()),
            ("schedule", schedule.is_some()),
            ("follow", follow.is_some()),
            ("duration_ns", duration_ns.is_some()),
            ("ranges", self.ranges.is_some()),
            ("interval_ns", self.interval_ns.is_some()),
            ("point", self.point.is_some()),
            ("value", self.value.is_some()),
            ("name", self.name.is_some()),
            ("text", self.text.is_some()),
            ("program", program.is_some()),
            ("part", part.is_some()),
            ("parts", parts.is_some()),
            ("data", data.is_some()),
        ];
        let malformed = |text| Refusal::new(ErrorKind::Malformed, text);
        let missing = |key: &str| malformed(format!("\"{request}\" needs the key `{key}`"));
        let named = |name: Option<String>, key: &str| name.ok_or_else(|| missing(key));
        let (checked, allowed): (Request, &[&str]) = match request.as_str() {
            "ping" => (Request::Ping, &[]),
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
            "watch" => {
                let raw = self.ranges.as_ref().ok_or_else(|| missing("ranges"))?;
                let ranges = point::ranges(raw).ok_or_else(|| {
                    malformed(format!(
                        "`ranges` must be at most {WATCHED_RANGES} lists of program, area (1 to 4), \
                         offset and bytes (1 to 65535)"
                    ))
                })?;
                let interval = Nanos(self.interval_ns.unwrap_or(0));
                if interval > INTERVAL_MAX {
                    let text = format!("`interval_ns` must be 0 to {}", INTERVAL_MAX.0);
                    return Err(malformed(text));
                }
                let partition = named(partition, "partition")?;
                let watch = Request::Watch { partition, ranges, interval };
                (watch, &["partition", "ranges", "interval_ns"])
            }
            "write" => (Request::Write(self.value(partition)?), PointValue::KEYS),
            "force" => (Request::Force(self.value(partition)?), PointValue::KEYS),
            "release" => {
                let point = self.point.map(|raw| point::point(raw).ok_or_else(no_point));
                let partition = named(partition, "partition")?;
                (Request::Release(partition, point.transpose()?), &["partition", "point"])
            }
            "load" => {
                let (part, parts) =
                    (part.ok_or_else(|| missing("part"))?, parts.ok_or_else(|| missing("parts"))?);
                let bytes = bytes_of(data, PART_MAX)?;
                if part >= parts {
                    return Err(malformed("`part` must be less than `parts`".to_owned()));
                }
                let load = Load {
                    partition: named(partition, "partition")?,
                    program: named(program, "program")?,
                    part,
                    parts,
                    data: bytes,
                };
                (Request::Load(load), &["partition", "program", "part", "parts", "data"])
            }
            "commit" => (
                Request::Commit(named(partition, "partition")?, named(program, "program")?),
                &["partition", "program"],
            ),
            "roll-back" => (
                Request::RollBack(named(partition, "partition")?, named(program, "program")?),
                &["partition", "program"],
            ),
            "versions" => (Request::Versions(named(partition, "partition")?), &["partition"]),
            "attach" => (Request::Attach(named(partition, "partition")?), &["partition"]),
            "type" => {
                let bytes = bytes_of(data, TYPED_MAX)?;
                (Request::Type(named(partition, "partition")?, bytes), &["partition", "data"])
            }
            _ => {
                let text = "`request` must be \"ping\", \"status\", \"stop\", \"start\", \"restart\", \
                            \"schedule\", \"events\", \"trace\", \"watch\", \"write\", \"force\", \
                            \"release\", \"load\", \"commit\", \"roll-back\", \"versions\", \"attach\" \
                            or \"type\"";
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

    /// The value of a `write` or a `force`.
    fn value(&self, partition: Option<String>) -> Result<PointValue, Refusal> {
        let missing = |key: &str| {
            let text = format!("\"{}\" needs the key `{key}`", self.request);
            Refusal::new(ErrorKind::Malformed, text)
        };
        let (name, text) = (self.name.clone(), self.text.clone());
        let named =
            Named::new(name.ok_or_else(|| missing("name"))?, text.ok_or_else(|| missing("text"))?);
        Ok(PointValue {
            partition: partition.ok_or_else(|| missing("partition"))?,
            point: point::point(self.point.ok_or_else(|| missing("point"))?)
                .ok_or_else(no_point)?,
            value: self.value.ok_or_else(|| missing("value"))?,
            named: named.ok_or_else(|| {
                let text = format!(
                    "`name` and `text` must be 1 to {LABEL_MAX} bytes without control characters"
                );
                Refusal::new(ErrorKind::Malformed, text)
            })?,
        })
    }
}

impl PointValue {
    const KEYS: &[&str] = &["partition", "point", "value", "name", "text"];

    fn raw(&self, raw: Raw) -> Raw {
        Raw {
            point: Some(raw_point(self.point)),
            value: Some(self.value),
            name: Some(self.named.name.clone()),
            text: Some(self.named.text.clone()),
            ..raw
        }
    }
}

/// The bytes of a request, at least one.
fn bytes_of(data: Option<&str>, most: usize) -> Result<Vec<u8>, Refusal> {
    let bytes = data.and_then(from_hex).unwrap_or_default();
    if bytes.is_empty() || bytes.len() > most {
        let text = format!("`data` must be 2 to {} hexadecimal digits", 2 * most);
        return Err(Refusal::new(ErrorKind::Malformed, text));
    }
    Ok(bytes)
}

fn no_point() -> Refusal {
    let text = "`point` must be a list of program, area (1 to 4), offset, bytes (1 to 8), and 255 or, of \
                one byte, a bit (0 to 7)";
    Refusal::new(ErrorKind::Malformed, text)
}
