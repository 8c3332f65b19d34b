//! `takt plc record`: values of a PLC that runs, in each cycle around a trigger, in a file.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};
use takt_plan::parse_duration;
use takt_protocol::Request;
use takt_scheduler::time::Nanos;

use crate::Failure;
use crate::live::points::Point;
use crate::live::recording::{Line, Recording, Row};
use crate::live::trigger::{Operator, Written, Wrong};
use crate::live::{Plc, Which, bytes, cut};
use crate::status;
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
    /// The file to write: .csv for tables, .json for ui.perfetto.dev.
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
        if form == Form::Json
            && let Some(text) = points.iter().find(|point| point.value(&[]).is_none())
        {
            let message =
                format!("{} is a {} and no number: record it as .csv", text.name, text.type_name);
            return Err(Failure::input(message));
        }
        // The value of the trigger comes last.
        let mut watched = points.clone();
        watched.extend(trigger.iter().map(|trigger| trigger.point.clone()));
        let mut connected = plc.connect()?;
        let failed = |error: io::Error| {
            Failure::input(format!("cannot write {}: {error}", self.out.display()))
        };
        let out = BufWriter::new(File::create(&self.out).map_err(failed)?);
        let mut out = Writer { form, out, points: &points };
        out.begin(&connected.name()).map_err(failed)?;
        connected.ask(&Request::Watch {
            partition: connected.name(),
            ranges: watched.iter().map(|point| point.range).collect(),
            interval: Nanos::ZERO,
        })?;
        let mut recording = Recording::new(self.pre, self.duration);
        while !recording.is_over() {
            let values = connected.values()?;
            let bytes = bytes(&values.bytes);
            let Some(bytes) = bytes.filter(|bytes| cut(&watched, bytes).is_some()) else {
                let message = "the values that came are not those that were asked for".to_owned();
                return Err(Failure { status: status::NO_TAKT, message });
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
                out.row(&row).map_err(failed)?;
            }
        }
        out.end().map_err(failed)?;
        let extent = recording.extent();
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
        let mut found = found.map_err(|error| failed(at_name(error.message)))?;
        if found.len() > 1 {
            let message = format!("this means {} values; name one", found.len());
            return Err(failed(at_name(message)));
        }
        let point = found.pop().ok_or_else(|| failed(at_name("no value has this name".into())))?;
        let value = point.constant(written.value);
        let value = value.map_err(|message| failed(Wrong { at: written.value_at, message }))?;
        Ok(Self { point, operator: written.operator, value })
    }

    fn holds(&self, bytes: &[u8]) -> bool {
        self.point.value(bytes).is_some_and(|value| self.operator.holds(value, self.value))
    }
}

/// What the file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Csv,
    Json,
}

impl Form {
    fn of(path: &Path) -> Result<Self, Failure> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("csv") => Ok(Form::Csv),
            Some("json") => Ok(Form::Json),
            _ => Err(Failure::input(format!("{} must end in .csv or .json", path.display()))),
        }
    }
}

/// The file.
struct Writer<'p, W> {
    form: Form,
    out: W,
    points: &'p [Point],
}

impl<W: Write> Writer<'_, W> {
    fn begin(&mut self, partition: &str) -> io::Result<()> {
        match self.form {
            Form::Csv => {
                let names = self.points.iter().map(|point| field(&point.name));
                let head = ["cycle", "release_ns", "gap", "unsettled"].map(String::from);
                let head: Vec<String> = head.into_iter().chain(names).collect();
                writeln!(self.out, "{}", head.join(","))
            }
            Form::Json => {
                let args = json!({"name": format!("values of {partition}")});
                let name = json!({"name": "process_name", "ph": "M", "pid": PROCESS, "args": args});
                write!(self.out, "[\n{name}")
            }
        }
    }

    fn row(&mut self, row: &Row) -> io::Result<()> {
        let Line { cycle, release_ns, unsettled, bytes } = &row.line;
        // The trigger's own value, behind those that are wanted, is not written.
        let mut rest = &bytes[..];
        let values: Vec<(&Point, &[u8])> = self
            .points
            .iter()
            .filter_map(|point| {
                let (value, more) = rest.split_at_checked(point.range.bytes.into())?;
                rest = more;
                Some((point, value))
            })
            .collect();
        if self.form == Form::Csv {
            write!(self.out, "{cycle},{release_ns},{},{unsettled}", row.gap)?;
            for (point, value) in values {
                write!(self.out, ",{}", field(&point.show(value)))?;
            }
            return writeln!(self.out);
        }
        let ts = *release_ns as f64 / 1_000.0;
        if row.gap > 0 {
            let args = json!({"cycles": row.gap});
            let gap = json!({"name": "gap", "ph": "i", "s": "p", "ts": ts, "pid": PROCESS, "tid": 1, "args": args});
            write!(self.out, ",\n{gap}")?;
        }
        for (point, value) in values {
            let Some(number) = point.value(value).and_then(number) else { continue };
            let counter = json!({"name": point.name, "ph": "C", "ts": ts, "pid": PROCESS, "args": {"value": number}});
            write!(self.out, ",\n{counter}")?;
        }
        Ok(())
    }

    fn end(&mut self) -> io::Result<()> {
        if self.form == Form::Json {
            writeln!(self.out, "\n]")?;
        }
        self.out.flush()
    }
}

/// The number of the process in the trace: the partitions of the windows' trace have lower ones.
const PROCESS: u32 = 1_000;

/// A value as a number; a REAL that is none has no place in a picture.
fn number(value: Value) -> Option<Json> {
    match value {
        Value::Bool(on) => Some(u8::from(on).into()),
        Value::Signed(number) | Value::Duration(number) => Some(number.into()),
        Value::Unsigned(number) => Some(number.into()),
        Value::Float(number) => serde_json::Number::from_f64(number).map(Json::Number),
    }
}

/// A field of a table in CSV.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_of_a_table_is_one_field_whatever_is_in_it() {
        assert_eq!(field("tank.level"), "tank.level");
        assert_eq!(field("'a, \"b\"'"), "\"'a, \"\"b\"\"'\"");
        assert_eq!(field("a\nb"), "\"a\nb\"");
    }

    #[test]
    fn only_numbers_are_drawn() {
        assert_eq!(number(Value::Bool(true)), Some(json!(1)));
        assert_eq!(number(Value::Signed(-3)), Some(json!(-3)));
        assert_eq!(number(Value::Float(f64::INFINITY)), None);
        assert_eq!(number(Value::Float(0.5)), Some(json!(0.5)));
    }

    #[test]
    fn the_name_of_the_file_says_what_it_becomes() {
        assert_eq!(Form::of(Path::new("a.csv")).ok(), Some(Form::Csv));
        assert_eq!(Form::of(Path::new("a.json")).ok(), Some(Form::Json));
        let refused = Form::of(Path::new("a.svg")).err().map(|failure| failure.message);
        assert_eq!(refused.as_deref(), Some("a.svg must end in .csv or .json"));
    }
}
