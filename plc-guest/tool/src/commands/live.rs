//! `takt plc points`, `watch`, `write`, `force`, `release`: values of a PLC that runs.

use std::io::{self, Write as _};

use serde_json::{Map, Value as Json, json};
use takt_plan::parse_duration;
use takt_points::{Connected, Point, ranges, texts};
use takt_protocol::{Answer, Named, PointValue, Request, Values};

use crate::Failure;
use crate::live::{Which, written};

/// Arguments of `points`.
#[derive(clap::Args)]
pub struct Points {
    #[command(flatten)]
    which: Which,
    /// Names of variables or of parts of them, such as tank.level; `*` is any text.
    #[arg(value_name = "NAME", default_value = "*")]
    names: Vec<String>,
    /// One JSON object on each line.
    #[arg(long)]
    json: bool,
}

impl Points {
    pub fn run(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        for point in plc.points(&self.names)? {
            let line = if self.json {
                json!({"name": point.name, "type": point.type_name, "address": point.address()})
                    .to_string()
            } else {
                format!("{:40} {:12} {}", point.name, point.type_name, point.address())
            };
            print(&line)?;
        }
        Ok(())
    }
}

/// Arguments of `watch`.
#[derive(clap::Args)]
pub struct Watch {
    #[command(flatten)]
    which: Which,
    /// Names of variables or of parts of them, such as tank.level; `*` is any text.
    #[arg(value_name = "NAME", required = true)]
    names: Vec<String>,
    /// Least time from one line to the next; 0ms is each cycle.
    #[arg(long, value_name = "DURATION", default_value = "500ms", value_parser = parse_duration)]
    every: takt_scheduler::time::Nanos,
    /// End after so many lines.
    #[arg(long, value_name = "N")]
    lines: Option<u64>,
    /// One JSON object on each line.
    #[arg(long)]
    json: bool,
}

impl Watch {
    pub fn run(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        let points = plc.points(&self.names)?;
        let mut connected = plc.connect()?;
        let watch = Request::Watch {
            partition: connected.name(),
            ranges: ranges(&points),
            interval: self.every,
        };
        connected.ask(&watch)?;
        let mut told = 0;
        while self.lines.is_none_or(|lines| told < lines) {
            let values = connected.values()?;
            let line = texts(&points, &values)?;
            print(&shown(&points, &values, line, self.json))?;
            told += 1;
        }
        Ok(())
    }
}

/// A line of values.
fn shown(points: &[Point], values: &Values, line: Vec<String>, json: bool) -> String {
    let all = points.iter().zip(line);
    if json {
        let all: Map<String, Json> =
            all.map(|(point, value)| (point.name.clone(), value.into())).collect();
        return json!({
            "cycle": values.cycle, "release_ns": values.release_ns, "missed": values.missed,
            "unsettled": values.unsettled, "values": all
        })
        .to_string();
    }
    let mut text = format!("{:12.3} s  cycle {}", values.release_ns as f64 / 1e9, values.cycle);
    for (point, value) in all {
        text.push_str(&format!("  {} = {value}", point.name));
    }
    if values.missed > 0 {
        text.push_str(&format!("  ({} missed before)", values.missed));
    }
    if values.unsettled != 0 {
        text.push_str("  (in the middle of something)");
    }
    text
}

/// Arguments of `write` and `force`.
#[derive(clap::Args)]
pub struct Put {
    #[command(flatten)]
    which: Which,
    /// The name of one value, such as `tank.level` or `tank.row[2]`.
    name: String,
    /// Its value, as in Structured Text.
    #[arg(allow_hyphen_values = true)]
    value: String,
}

impl Put {
    /// Writes the value once.
    pub fn write(self) -> Result<(), Failure> {
        self.run(Request::Write, |point| {
            point.is_constant().then_some("it is a constant of the program")
        })
    }

    /// Keeps the value from now on.
    pub fn force(self) -> Result<(), Failure> {
        self.run(Request::Force, |point| {
            (!point.is_forceable()).then_some("the program does not declare it as forceable")
        })
    }

    fn run(
        self,
        request: fn(PointValue) -> Request,
        objection: fn(&Point) -> Option<&'static str>,
    ) -> Result<(), Failure> {
        let plc = self.which.load()?;
        let point = one(&plc.points(std::slice::from_ref(&self.name))?)?;
        if let Some(objection) = objection(&point) {
            return Err(Failure::input(format!("{}: {objection}", point.name)));
        }
        let (value, text) = written::parse(&point, &self.value)
            .map_err(|error| Failure::input(format!("{}: {error}", point.name)))?;
        let mut connected = plc.connect()?;
        let place = takt_protocol::Point::new(point.range, point.bit);
        let place = place.ok_or_else(|| Failure::input(format!("{} has no place", point.name)))?;
        let named = Named { name: point.name.clone(), text };
        let partition = connected.name();
        done(&mut connected, &request(PointValue { partition, point: place, value, named }))
    }
}

/// Arguments of `release`.
#[derive(clap::Args)]
pub struct Release {
    #[command(flatten)]
    which: Which,
    /// Names of values that are forced.
    #[arg(value_name = "NAME", required_unless_present = "all", conflicts_with = "all")]
    names: Vec<String>,
    /// All that is forced in the partition.
    #[arg(long)]
    all: bool,
}

impl Release {
    pub fn run(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        if self.all {
            // It names no place, so it is the same in each version: an operator need not find the image that runs.
            let mut connected = plc.reach()?;
            let all = Request::Release(connected.name(), None);
            return done(&mut connected, &all);
        }
        let mut connected = plc.connect()?;
        let partition = connected.name();
        for name in &self.names {
            let point = one(&plc.points(std::slice::from_ref(name))?)?;
            let place = takt_protocol::Point::new(point.range, point.bit);
            let place = place.ok_or_else(|| Failure::input(format!("{name} has no place")))?;
            done(&mut connected, &Request::Release(partition.clone(), Some(place)))?;
        }
        Ok(())
    }
}

fn one(points: &[Point]) -> Result<Point, Failure> {
    match points {
        [point] => Ok(point.clone()),
        [first, ..] => Err(Failure::input(format!(
            "this means {} values, of which {} is the first; name one",
            points.len(),
            first.name
        ))),
        [] => Err(Failure::input("no value has this name")),
    }
}

fn done(connected: &mut Connected<'_>, request: &Request) -> Result<(), Failure> {
    match connected.ask(request)? {
        Answer::Done { text } => print(&takt_client::plain(&text)),
        _ => Ok(()),
    }
}

/// A reader that has had enough ends it without a word, as with any filter.
pub fn print(line: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush()).map_err(|error| match error.kind() {
        io::ErrorKind::BrokenPipe => std::process::exit(crate::READER_GONE),
        _ => Failure::input(format!("cannot print: {error}")),
    })
}
