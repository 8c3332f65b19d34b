//! Answers for people.

use std::fmt::Write;

pub use takt_client::plain;
use takt_protocol::{Answer, Event, Mode, PartitionStatus, State, Status};

use crate::channels;
use crate::programs;
use crate::trace::Extent;

/// An answer as lines. A refusal is none: it goes to standard error.
pub fn of(answer: &Answer) -> String {
    match answer {
        Answer::Done { text } => format!("{}\n", plain(text)),
        Answer::Status { status } => self::status(status),
        Answer::Events { events } => events.iter().map(|e| event(e) + "\n").collect(),
        Answer::Event { event: e } => event(e) + "\n",
        Answer::Versions { versions } => {
            versions.iter().map(takt_client::versions::shown).collect()
        }
        // A trace is for a viewer.
        Answer::Trace { .. } | Answer::Window { .. } | Answer::Switch { .. } => String::new(),
        Answer::Traced { .. } | Answer::Error(_) => String::new(),
        // Values are for a client that knows the program.
        Answer::Watching { .. } | Answer::Values { .. } => String::new(),
        // A console is for `takt console`.
        Answer::Attached { .. } | Answer::Console { .. } | Answer::Typed { .. } => String::new(),
    }
}

/// How much of its time a trace has, in one line.
pub fn extent(Extent { windows, dropped }: Extent) -> String {
    match dropped {
        0 => format!("{windows} windows, all that Takt has recorded"),
        _ => format!(
            "{windows} windows; {dropped} more are missing, for this program read too slowly"
        ),
    }
}

/// An event in one line.
pub fn event(event: &Event) -> String {
    let at = event.at_ns as f64 / 1e9;
    let whose = event.partition.as_ref().map_or(String::new(), |name| format!("{name}: "));
    plain(&format!("{at:12.3} s  {whose}{}", event.text))
}

/// What the system is and which schedule holds, in one line.
pub fn summary(status: &Status) -> String {
    let up = status.uptime_ns as f64 / 1e9;
    let schedule = &status.schedule;
    let next = if schedule.next == schedule.current {
        String::new()
    } else {
        format!(", next \"{}\"", schedule.next)
    };
    plain(&format!(
        "{}: up {up:.1} s, schedule \"{}\"{next}, major frame {} us",
        status.system,
        schedule.current,
        status.major_frame_ns as f64 / 1e3,
    ))
}

/// Titles of a table of partitions.
pub const COLUMNS: [&str; 10] = [
    "partition",
    "cpu",
    "state",
    "start",
    "CPU",
    "restarts",
    "releases",
    "lost",
    "late",
    "overruns",
];

/// A state in one word.
pub fn state(state: State) -> &'static str {
    match state {
        State::Running => "running",
        State::Stopping => "stopping",
        State::Restarting => "restarting",
        State::Stopped => "stopped",
        State::Ended => "ended",
    }
}

/// A row of that table.
pub fn row(partition: &PartitionStatus) -> [String; 10] {
    let start = match partition.start_mode {
        Mode::Cold => "cold",
        Mode::Warm => "warm",
    };
    let releases = partition.releases.as_ref();
    let count = |count: Option<u64>| count.map_or("-".to_owned(), |count| count.to_string());
    [
        plain(&partition.name),
        partition.cpu.to_string(),
        state(partition.state).to_owned(),
        start.to_owned(),
        format!("{:.1} %", partition.cpu_share * 100.0),
        partition.restarts.to_string(),
        count(releases.map(|r| r.happened)),
        count(releases.map(|r| r.lost)),
        count(releases.map(|r| r.late)),
        count(releases.map(|r| r.overruns)),
    ]
}

/// Release latency since the start, in one line; `None` for a partition without.
pub fn latency(partition: &PartitionStatus) -> Option<String> {
    let releases = partition.releases.as_ref()?;
    let name = plain(&partition.name);
    let tasks = match releases.unfinished_windows {
        0 => String::new(),
        count => format!("; in {count} windows tasks went on in the next"),
    };
    let unrecorded = match releases.unrecorded {
        0 => String::new(),
        count => format!("; {count} windows are missing in all of these figures"),
    };
    Some(match releases.release_latency_ns {
        None => format!("{name}: no release yet{unrecorded}"),
        Some(s) => format!(
            "{name}: release latency p50 {}, p99 {}, p99.9 {}, max {} ns{tasks}{unrecorded}",
            s.p50, s.p99, s.p999, s.max
        ),
    })
}

fn status(status: &Status) -> String {
    let mut out = summary(status);
    out.push_str("\n\n");
    out.push_str(&table(COLUMNS, status.partitions.iter().map(row)));
    if !status.channels.is_empty() {
        out.push('\n');
        out.push_str(&table(channels::COLUMNS, status.channels.iter().map(channels::row)));
    }
    let tasks: Vec<[String; 8]> = status.partitions.iter().flat_map(programs::rows).collect();
    if !tasks.is_empty() {
        out.push('\n');
        out.push_str(&table(programs::COLUMNS, tasks.into_iter()));
    }
    let forced = status.partitions.iter().flat_map(programs::forced);
    let latencies = status.partitions.iter().filter_map(latency);
    let ends = status.partitions.iter().filter_map(|p| Some((&p.name, p.end.as_ref()?)));
    let ends = ends.map(|(name, end)| plain(&format!("{name}: {end}")));
    let problems = status.channels.iter().filter_map(channels::problem);
    for line in forced.chain(latencies).chain(ends).chain(problems) {
        let _ = write!(out, "\n{line}");
    }
    out.push('\n');
    out
}

/// Rows below their titles, each column as wide as it has to be.
fn table<const N: usize>(titles: [&str; N], rows: impl Iterator<Item = [String; N]>) -> String {
    let rows: Vec<[String; N]> = std::iter::once(titles.map(str::to_owned)).chain(rows).collect();
    let mut out = String::new();
    for row in &rows {
        let mut line = String::new();
        for (column, cell) in row.iter().enumerate() {
            let width = rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
            // Writing to a String cannot fail.
            let _ = write!(line, "{cell:width$}  ");
        }
        out.push_str(line.trim_end());
        out.push('\n');
    }
    out
}
