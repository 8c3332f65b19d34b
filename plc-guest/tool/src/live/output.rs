//! The file of a recording: a table, counters for Perfetto, or a picture.

use std::io::{self, Write};
use std::path::Path;

use serde_json::{Value as Json, json};

use takt_points::Point;
use takt_scheduler::time::Nanos;

use super::plot::{self, Plot};
use super::recording::{Extent, Line, Row};
use crate::Failure;
use crate::value::Value;

/// What the file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Csv,
    Json,
    Svg,
}

impl Form {
    /// By the ending of its name.
    pub fn of(path: &Path) -> Result<Self, Failure> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("csv") => Ok(Form::Csv),
            Some("json") => Ok(Form::Json),
            Some("svg") => Ok(Form::Svg),
            _ => Err(Failure::input(format!("{} must end in .csv, .json or .svg", path.display()))),
        }
    }

    /// Whether all of these points can be in it.
    pub fn takes(self, points: &[Point]) -> Result<(), Failure> {
        if self == Form::Csv {
            return Ok(());
        }
        if let Some(text) = points.iter().find(|point| point.value(&[]).is_none()) {
            let message =
                format!("{} is a {} and no number: record it as .csv", text.name, text.type_name);
            return Err(Failure::input(message));
        }
        if self == Form::Svg && points.len() > plot::CURVES_MAX {
            let message = format!(
                "these are {} values, and a picture has at most {}: name fewer, or record a .csv",
                points.len(),
                plot::CURVES_MAX
            );
            return Err(Failure::input(message));
        }
        Ok(())
    }
}

/// The file.
pub struct Writer<'p, W> {
    form: Form,
    out: W,
    points: &'p [Point],
    plot: Plot,
}

impl<'p, W: Write> Writer<'p, W> {
    /// Of these points, the trigger being so long after the beginning at most, and so long before the end.
    pub fn new(form: Form, out: W, points: &'p [Point], [before, after]: [Nanos; 2]) -> Self {
        Self { form, out, points, plot: Plot::new(points.len(), before, after) }
    }

    /// What comes before the first row.
    pub fn begin(&mut self, partition: &str) -> io::Result<()> {
        match self.form {
            Form::Svg => Ok(()),
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

    /// A row of the recording whose trigger was at this instant.
    pub fn row(&mut self, row: &Row, triggered_ns: u64) -> io::Result<()> {
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
        if self.form == Form::Svg {
            let numbers = values.iter().map(|(point, value)| point.value(value).map(place));
            self.plot.row(*release_ns, triggered_ns, row.gap > 0, numbers);
            return Ok(());
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

    /// What comes after the last row.
    pub fn end(&mut self, extent: &Extent) -> io::Result<()> {
        match self.form {
            Form::Csv => {}
            Form::Json => writeln!(self.out, "\n]")?,
            Form::Svg => {
                let names: Vec<&str> = self.points.iter().map(|point| &*point.name).collect();
                let svg = self.plot.draw(&names, extent).map_err(io::Error::other)?;
                self.out.write_all(svg.as_bytes())?;
            }
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

/// A value as a place in a picture; not finite for a REAL that is none.
fn place(value: Value) -> f64 {
    match value {
        Value::Bool(on) => u8::from(on).into(),
        Value::Signed(number) | Value::Duration(number) => number as f64,
        Value::Unsigned(number) => number as f64,
        Value::Float(number) => number,
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
        assert_eq!(Form::of(Path::new("a.svg")).ok(), Some(Form::Svg));
        let refused = Form::of(Path::new("a.png")).err().map(|failure| failure.message);
        assert_eq!(refused.as_deref(), Some("a.png must end in .csv, .json or .svg"));
    }
}
