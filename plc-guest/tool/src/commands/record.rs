//! `takt plc record`: values of a PLC that runs, in each cycle around a trigger, in a file.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::PathBuf;

use takt_plan::parse_duration;
use takt_points::{Plc, Point, cut, not_asked_for, ranges};
use takt_protocol::{Request, from_hex};
use takt_scheduler::time::Nanos;

use crate::Failure;
use crate::live::output::{Form, Writer};
use crate::live::recording::{Line, Recording};
use crate::live::trigger::{Operator, Written, Wrong};
use crate::live::{Which, written};
use crate::value::Value;

/// Longest time before the trigger.
const BEFORE_MAX: Nanos = Nanos(60_000_000_000);

/// Arguments of `record`.
#[derive(clap::Args)]
pub struct Record {
    #[command(flatten)]
    which: Which,
    /// Names of variables or of parts of them, such as tank.level; `*` is any text.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true)]
    points: Vec<String>,
    /// Wait until this holds in a cycle, such as 'tank.level > 1.1'; without it the recording begins at once. The
    /// comparisons are < <= = <> >= >.
    #[arg(long, value_name = "CONDITION")]
    trigger: Option<String>,
    /// Record so much before the trigger too, at most 60s.
    #[arg(long, value_name = "DURATION", default_value = "0ms", value_parser = parse_duration)]
    pre: Nanos,
    /// End so long after the trigger.
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_duration)]
    duration: Nanos,
    /// The file to write: .csv for tables, .json for ui.perfetto.dev, .svg for a picture.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

impl Record {
    pub fn run(self) -> Result<(), Failure> {
        let form = Form::of(&self.out)?;
        if self.pre > BEFORE_MAX {
            return Err(Failure::input("--pre is at most 60s"));
        }
        let plc = self.which.load()?;
        let points = plc.points(&self.points)?;
        let trigger = self.trigger.as_deref().map(|text| Trigger::find(&plc, text)).transpose()?;
        form.takes(&points)?;
        // The value of the trigger comes last.
        let mut watched = points.clone();
        watched.extend(trigger.iter().map(|trigger| trigger.point.clone()));
        let mut connected = plc.connect()?;
        let failed = |error: io::Error| {
            Failure::input(format!("cannot write {}: {error}", self.out.display()))
        };
        let out = BufWriter::new(File::create(&self.out).map_err(failed)?);
        let mut out = Writer::new(form, out, &points, [self.pre, self.duration]);
        out.begin(&connected.name()).map_err(failed)?;
        connected.ask(&Request::Watch {
            partition: connected.name(),
            ranges: ranges(&watched),
            interval: Nanos::ZERO,
        })?;
        let mut recording = Recording::new(self.pre, self.duration);
        while !recording.is_over() {
            let values = connected.values()?;
            let bytes = from_hex(&values.bytes);
            let Some(bytes) = bytes.filter(|bytes| cut(&watched, bytes).is_some()) else {
                return Err(not_asked_for().into());
            };
            let line = Line {
                cycle: values.cycle,
                release_ns: values.release_ns,
                unsettled: values.unsettled,
                bytes,
            };
            let holds = |line: &Line| {
                let last = cut(&watched, &line.bytes).and_then(|all| all.last().copied());
                trigger.as_ref().is_none_or(|t| last.is_some_and(|bytes| t.holds(bytes)))
            };
            for row in recording.take(line, holds) {
                out.row(&row, recording.extent().triggered_ns).map_err(failed)?;
            }
        }
        let extent = recording.extent();
        out.end(&extent).map_err(failed)?;
        eprintln!(
            "takt plc: {} cycles recorded, {} missing between them; triggered at {:.6} s",
            extent.rows,
            extent.gaps,
            extent.triggered_ns as f64 / 1e9
        );
        if extent.not_kept > 0 {
            eprintln!(
                "takt plc: the time before the trigger is shorter than --pre: too many bytes"
            );
        }
        Ok(())
    }
}

/// A trigger with its point.
struct Trigger {
    point: Point,
    operator: Operator,
    value: Value,
}

impl Trigger {
    fn find(plc: &Plc, text: &str) -> Result<Self, Failure> {
        let failed = |wrong: Wrong| Failure::input(wrong.shown(text));
        let written = Written::parse(text).map_err(failed)?;
        let at_name = |message| Wrong { at: written.name_at, message };
        let found = plc.points(&[written.name.to_owned()]);
        let mut found = found.map_err(|error| failed(at_name(error.to_string())))?;
        if found.len() > 1 {
            let message = format!("this means {} values; name one", found.len());
            return Err(failed(at_name(message)));
        }
        let point = found.pop().ok_or_else(|| failed(at_name("no value has this name".into())))?;
        let value = written::constant(&point, written.value);
        let value = value.map_err(|message| failed(Wrong { at: written.value_at, message }))?;
        Ok(Self { point, operator: written.operator, value })
    }

    fn holds(&self, bytes: &[u8]) -> bool {
        self.point.value(bytes).is_some_and(|value| self.operator.holds(value, self.value))
    }
}
