//! Samples: how the releases of a run went, in little enough to be carried out of the appliance.
//!
//! A report has five figures of each quantity, which show neither a drift nor a second hump. A trace
//! has everything, 800 bytes a window, which is too much for a run of hours. In between lie two
//! things of fixed size: the whole distribution of each quantity, and its course over time.
//!
//! The course is decimated so that the worst cannot be lost. Each point stands for a number of
//! releases in a row and keeps the least and the greatest value among them. Up to [`POINTS_MAX`]
//! releases each has a point of its own; whenever the points are full, neighbours are merged in
//! pairs, and a point stands for twice as many from then on. Every value is in some point's range,
//! but when in that point it occurred is not known.
//!
//! The distributions are histograms with three significant digits: exact below 2048 ns, within one
//! part in a thousand above.
//!
//! All of this happens on the supervisor thread, when it empties the rings. The memory of the points is
//! taken before the run starts.

use serde::{Deserialize, Serialize};
use takt_scheduler::time::{Nanos, Timebase, Tsc};

use crate::load;
use crate::statistics::{Distribution, Releases};
use takt_record::WindowRecord;

/// Version of the file: grows with every change that a reader could stumble over.
pub const SCHEMA_VERSION: u32 = 2;
/// Most points of a course. A plot is about as many dots wide.
pub const POINTS_MAX: usize = 1024;

/// The samples of a run. Field names are the JSON keys; times are nanoseconds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Samples {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Those with windows and a scan, in the order of the partition file.
    pub partitions: Vec<Course>,
    /// What loads have got done: those of consoles that told of one.
    pub loads: Vec<load::Course>,
}

/// How the releases of one partition went.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Course {
    /// The partition's name.
    pub name: String,
    /// Releases that a point stands for; the last one may stand for fewer.
    pub releases_per_point: u64,
    /// In the order of time.
    pub points: Vec<Point>,
    /// From the release to the guest's start: each value, and how often it occurred.
    pub latency_ns: Vec<(u64, u64)>,
    /// From the guest's start to its end.
    pub execution_ns: Vec<(u64, u64)>,
    /// From the start of one scan to that of the next.
    pub interval_ns: Vec<(u64, u64)>,
    /// From the end of the guest's stay to the end of its window.
    pub donated_ns: Vec<(u64, u64)>,
}

/// Least and greatest value; in JSON an array of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Range(pub u64, pub u64);

/// Some releases in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Point {
    /// Sequence number of the first.
    pub release: u64,
    /// Where it lies after the epoch.
    pub at_ns: u64,
    /// How many there are.
    pub releases: u64,
    /// From the release to the guest's start.
    pub latency_ns: Range,
    /// From the guest's start to its end; `null` if no scan ended.
    pub execution_ns: Option<Range>,
    /// From the start of the scan before to this one's. A lost release makes it longer; a start of
    /// the guest begins anew. `null` for the first.
    pub interval_ns: Option<Range>,
    /// What was left of the window when the guest was out of it.
    pub donated_ns: Range,
}

impl Range {
    fn of(value: Nanos) -> Self {
        Self(value.0, value.0)
    }

    fn with(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.max(other.1))
    }
}

/// The range of both, as far as there are any.
fn either(a: Option<Range>, b: Option<Range>) -> Option<Range> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.with(b)),
        (a, b) => a.or(b),
    }
}

impl Point {
    fn merge(&mut self, later: &Point) {
        self.releases += later.releases;
        self.latency_ns = self.latency_ns.with(later.latency_ns);
        self.execution_ns = either(self.execution_ns, later.execution_ns);
        self.interval_ns = either(self.interval_ns, later.interval_ns);
        self.donated_ns = self.donated_ns.with(later.donated_ns);
    }
}

/// Keeps the course of one partition.
pub struct Recorder {
    base: Timebase,
    /// Start of the last scan, of the same start of the guest.
    previous: Option<Tsc>,
    points: Vec<Point>,
    releases_per_point: u64,
    interval: Distribution,
    donated: Distribution,
}

impl Recorder {
    /// An empty one; `None` only if the histogram library refuses its constant parameter.
    #[must_use]
    pub fn new(base: Timebase) -> Option<Self> {
        Some(Self {
            base,
            previous: None,
            points: Vec::with_capacity(POINTS_MAX),
            releases_per_point: 1,
            interval: Distribution::new()?,
            donated: Distribution::new()?,
        })
    }

    /// The guest is started anew: no interval leads from a scan before to one after.
    pub fn restarted(&mut self) {
        self.previous = None;
    }

    /// Adds a window. One without a credible start has nothing to tell but by the interval that it
    /// makes longer.
    pub fn add(&mut self, record: &WindowRecord) {
        let Some(scan) = record.scan() else { return };
        let nanos = |ticks| self.base.frequency.nanos(ticks);
        let finished = (scan.start..=record.left).contains(&scan.done);
        let execution = finished.then(|| nanos(scan.done.since(scan.start)));
        let interval = self.previous.map(|previous| nanos(scan.start.since(previous)));
        let donated = nanos(record.end.since(record.left));
        let point = Point {
            release: record.sequence,
            at_ns: self.base.offset(record.release).0,
            releases: 1,
            latency_ns: Range::of(nanos(scan.start.since(record.release))),
            execution_ns: execution.map(Range::of),
            interval_ns: interval.map(Range::of),
            donated_ns: Range::of(donated),
        };
        self.previous = Some(scan.start);
        if let Some(interval) = interval {
            self.interval.record(interval);
        }
        self.donated.record(donated);
        self.push(point);
    }

    fn push(&mut self, point: Point) {
        if let Some(last) = self.points.last_mut()
            && last.releases < self.releases_per_point
        {
            last.merge(&point);
            return;
        }
        if self.points.len() >= POINTS_MAX {
            self.halve();
        }
        self.points.push(point);
    }

    /// Makes one point of each two.
    fn halve(&mut self) {
        for to in 0..self.points.len() / 2 {
            let (mut first, second) = (self.points[2 * to], self.points[2 * to + 1]);
            first.merge(&second);
            self.points[to] = first;
        }
        self.points.truncate(self.points.len() / 2);
        self.releases_per_point *= 2;
    }

    /// What was kept; `releases` has the rest.
    #[must_use]
    pub fn course(&self, name: &str, releases: &Releases) -> Course {
        Course {
            name: name.to_owned(),
            releases_per_point: self.releases_per_point,
            points: self.points.clone(),
            latency_ns: releases.latency().counts(),
            execution_ns: releases.execution().counts(),
            interval_ns: self.interval.counts(),
            donated_ns: self.donated.counts(),
        }
    }
}

#[cfg(test)]
#[path = "samples_tests.rs"]
mod tests;
