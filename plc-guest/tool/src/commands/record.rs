//! `takt plc record`: values of a PLC that runs, in each cycle around a trigger, in a file.

use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use takt_plan::parse_duration;
use takt_points::{Plc, Point, cut, not_asked_for, ranges};
use takt_protocol::{Request, Values, from_hex};
use takt_scheduler::time::Nanos;

use super::output::{Successor, open};
use crate::Failure;
use crate::live::interrupt;
use crate::live::output::{Form, Writer};
use crate::live::recording::{Extent, Line, Recording, Row};
use crate::live::trigger::{Operator, Written, Wrong};
use crate::live::{Which, values, written};
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
        connected.ask(&Request::Watch {
            partition: connected.name(),
            ranges: ranges(&watched),
            interval: Nanos::ZERO,
        })?;
        let failed = |error: io::Error| {
            Failure::input(format!("cannot write {}: {error}", self.out.display()))
        };
        interrupt::ends(connected.descriptor())
            .map_err(|error| Failure::input(format!("cannot take Ctrl-C: {error}")))?;
        // Not before Takt has granted it: the file may be a recording that somebody keeps.
        let (file, successor) = open(&self.out).map_err(failed)?;
        let mut out = Writer::new(form, BufWriter::new(file), &points, [self.pre, self.duration]);
        out.begin(&connected.name()).map_err(failed)?;
        let mut recording = Recording::new(self.pre, self.duration);
        let holds = |bytes: &[u8]| {
            let last = cut(&watched, bytes).and_then(|all| all.last().copied());
            trigger.as_ref().is_none_or(|t| last.is_some_and(|bytes| t.holds(bytes)))
        };
        let next = |left| {
            let Some(values) = values(&mut connected, left)? else { return Ok(None) };
            of_takt(values, &watched).map(Some).ok_or_else(|| not_asked_for().into())
        };
        let mut broken = None;
        let write = |row: &Row, triggered_ns| {
            out.row(row, triggered_ns).map_err(|error| {
                broken = Some(error.to_string());
                failed(error)
            })
        };
        let ended = record(&mut recording, next, holds, write);
        let extent = recording.extent();
        // Whatever has ended it, what is recorded is a whole file.
        let finished = out.end(&extent);
        let whole = broken.map_or(Ok(()), |text| Err(io::Error::other(text))).and(finished);
        tell(&extent);
        let kept = match successor {
            Some(_) if extent.rows == 0 => {
                tell!("takt plc: {} stays as it was", self.out.display());
                whole.map_err(failed)
            }
            Some(successor) => whole.map_err(failed).and_then(|()| replace(&self.out, successor)),
            None => whole.map_err(failed),
        };
        let ended = if interrupt::came() { Err(interrupted()) } else { ended };
        kept.and(ended)
    }
}

/// Puts the new recording into the place of the earlier one.
fn replace(out: &Path, successor: Successor) -> Result<(), Failure> {
    successor.take_place().map_err(|(error, new)| {
        let kept =
            new.map_or(String::new(), |new| format!("; the recording is in {}", new.display()));
        Failure::input(format!("cannot write {}: {error}{kept}", out.display()))
    })
}

/// A line of values, if it has as many bytes as were asked for.
fn of_takt(values: Values, watched: &[Point]) -> Option<Line> {
    let bytes = from_hex(&values.bytes).filter(|bytes| cut(watched, bytes).is_some())?;
    let Values { cycle, release_ns, unsettled, .. } = values;
    Some(Line { cycle, release_ns, unsettled, bytes })
}

/// Takes lines until the recording is over, no more come, or one of its ways fails. `next` is told how long it lasts still.
fn record(
    recording: &mut Recording,
    mut next: impl FnMut(Option<Nanos>) -> Result<Option<Line>, Failure>,
    holds: impl Fn(&[u8]) -> bool,
    mut write: impl FnMut(&Row, u64) -> Result<(), Failure>,
) -> Result<(), Failure> {
    while !recording.is_over() {
        let Some(line) = next(recording.left())? else { break };
        for row in recording.take(line, |line| holds(&line.bytes)) {
            write(&row, recording.extent().triggered_ns)?;
        }
    }
    Ok(())
}

/// The status is what a shell tells of a process that SIGINT ended.
fn interrupted() -> Failure {
    let message = "interrupted: what was recorded until then is kept".to_owned();
    Failure { status: 128 + libc::SIGINT as u8, message }
}

fn tell(extent: &Extent) {
    if extent.rows == 0 {
        tell!("takt plc: nothing is recorded: the trigger has not come");
        return;
    }
    tell!(
        "takt plc: {} cycles recorded, {} missing between them; triggered at {:.6} s",
        extent.rows,
        extent.gaps,
        extent.triggered_ns as f64 / 1e9
    );
    if extent.not_kept > 0 {
        tell!("takt plc: the time before the trigger is shorter than --pre: too many bytes");
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_recorded_when_takt_ends_is_written() {
        let line = |cycle: u64| {
            let bytes = vec![u8::from(cycle == 3)];
            Line { cycle, release_ns: cycle * 1_000, unsettled: 0, bytes }
        };
        let mut recording = Recording::new(Nanos(1_000), Nanos(1_000_000));
        let mut lines = (0..5).map(line);
        let mut left = Vec::new();
        let next = |time: Option<Nanos>| {
            left.push(time.map(|time| time.0));
            lines.next().map(Some).ok_or_else(|| Failure::input("the watch has ended"))
        };
        let mut written = Vec::new();
        let write = |row: &Row, triggered_ns| {
            written.push((row.line.cycle, triggered_ns));
            Ok(())
        };
        let ended = record(&mut recording, next, |bytes| bytes == [1], write);
        assert_eq!(
            ended.err().map(|failure| failure.message).as_deref(),
            Some("the watch has ended")
        );
        assert_eq!(written, [(2, 3_000), (3, 3_000), (4, 3_000)]);
        assert_eq!(recording.extent().rows, 3);
        assert_eq!(left, [None, None, None, None, Some(1_000_000), Some(999_000)]);
    }
}
