//! The progress of a load over time.
//!
//! What may be believed of it decides what is kept. The counts are the guest's word, so only a count
//! that grows is progress, and how much it grows proves nothing. The instants are Takt's own: those at
//! which it took a line from the console, up to a tick of the supervisor after the guest had written
//! it. A guest whose clock stands still, or runs fast, changes nothing about them.
//!
//! Memory is bounded as for the releases' samples ([`crate::samples`]): where the points are full they
//! are thinned, and the longest time without progress is kept apart from them, so that it is exact
//! however long the run is.

use serde::{Deserialize, Serialize};
use takt_scheduler::time::Nanos;

use super::line::{Lines, Word};

/// Most points of a course.
pub const POINTS_MAX: usize = 1024;

/// The progress of a load. Field names are the JSON keys; times are nanoseconds since the epoch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Course {
    /// The partition whose console told it.
    pub partition: String,
    /// The load, by its own word.
    pub load: String,
    /// What is counted.
    pub unit: String,
    /// When the first line came.
    pub began_ns: u64,
    /// When the last line came, of progress or not.
    pub last_line_ns: u64,
    /// Lines in all.
    pub lines: u64,
    /// The beginning, and the instants at which the count had grown, with what had been done since the
    /// beginning: both grow from point to point. The last is always there; of the others some are left
    /// out in a long run.
    pub points: Vec<(u64, u64)>,
    /// The longest time without progress.
    pub standstill: Standstill,
}

/// A time without progress.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standstill {
    /// When the count had grown last.
    pub from_ns: u64,
    /// When it grew again, or the end of the course.
    pub to_ns: u64,
    /// Lines of the load in between: a load that speaks and does nothing is one, and a Linux that is
    /// silent another.
    pub lines: u64,
}

impl Standstill {
    /// How long it was.
    #[must_use]
    pub fn duration(&self) -> Nanos {
        Nanos(self.to_ns.saturating_sub(self.from_ns))
    }
}

/// Keeps the course of one console's load.
#[derive(Debug, Default)]
pub struct Recorder {
    lines: Lines,
    kept: Option<Kept>,
    /// When the load was over, if that was before the run's end.
    ended: Option<Nanos>,
}

#[derive(Debug)]
struct Kept {
    /// As far as it is known before the end.
    course: Course,
    /// The greatest count since the load has begun, and what was done before, if it began anew.
    count: u64,
    before: u64,
    /// Lines since the last progress.
    idle_lines: u64,
    progressed: u64,
    /// Points closer together than this are one.
    spacing: u64,
}

impl Recorder {
    /// Takes what the console has shown, at `now` after the epoch.
    pub fn add(&mut self, bytes: &[u8], now: Nanos) {
        let Self { lines, kept, ended: None } = self else { return };
        lines.add(bytes, |line| {
            if let Some(word) = Word::of(line) {
                kept.get_or_insert_with(|| Kept::new(&word, now.0)).add(&word, now.0);
            }
        });
    }

    /// The load is over: the course ends here, whatever the console shows later.
    pub fn end(&mut self, now: Nanos) {
        self.ended.get_or_insert(now);
    }

    /// The course until the load was over, or until the end of the run; `None` if there was no load.
    #[must_use]
    pub fn course(&self, partition: &str, end: Nanos) -> Option<Course> {
        let (kept, end) = (self.kept.as_ref()?, self.ended.unwrap_or(end));
        let (partition, standstill) = (partition.to_owned(), kept.longest(end.0));
        Some(Course { partition, standstill, ..kept.course.clone() })
    }
}

impl Kept {
    fn new(word: &Word<'_>, at: u64) -> Self {
        let mut points = Vec::with_capacity(POINTS_MAX);
        points.push((at, word.count));
        Self {
            course: Course {
                partition: String::new(),
                load: word.load.to_owned(),
                unit: word.unit.to_owned(),
                began_ns: at,
                last_line_ns: at,
                lines: 0,
                points,
                // Of those after which there was progress again. The last one is added at the end.
                standstill: Standstill { from_ns: at, to_ns: at, lines: 0 },
            },
            count: word.count,
            before: 0,
            idle_lines: 0,
            progressed: at,
            spacing: 0,
        }
    }

    /// A line of another load than the first is none of this course.
    fn add(&mut self, word: &Word<'_>, at: u64) {
        if word.load != self.course.load || word.unit != self.course.unit {
            return;
        }
        self.course.lines += 1;
        self.course.last_line_ns = at;
        if word.count > self.count {
            self.course.standstill = self.longest(at);
            (self.count, self.progressed, self.idle_lines) = (word.count, at, 0);
            self.push((at, self.before.saturating_add(self.count)));
            return;
        }
        self.idle_lines += 1;
        // A load that begins anew, with its Linux or without, goes on from what was done. Any other
        // count that goes back is no progress until it is greater than all before.
        if word.count == 0 {
            self.before = self.before.saturating_add(self.count);
            self.count = 0;
        }
    }

    /// The longest time without progress, with the one that lasts at this time.
    fn longest(&self, now: u64) -> Standstill {
        let lasting = Standstill { from_ns: self.progressed, to_ns: now, lines: self.idle_lines };
        let ended = self.course.standstill;
        if lasting.duration() > ended.duration() { lasting } else { ended }
    }

    /// The newest point is always the last; it takes the place of one that is too close to the one
    /// before. Sums that do not grow any more have no point.
    fn push(&mut self, point: (u64, u64)) {
        let points = &mut self.course.points;
        if let Some(last) = points.last_mut()
            && (point.0 <= last.0 || point.1 <= last.1)
        {
            last.1 = last.1.max(point.1);
            return;
        }
        if let [.., before, last] = &mut points[..]
            && point.0 - before.0 < self.spacing
        {
            *last = point;
            return;
        }
        if points.len() >= POINTS_MAX {
            self.thin();
        }
        self.course.points.push(point);
    }

    /// Makes room: at most half of the points stay, evenly over the time.
    fn thin(&mut self) {
        let half = POINTS_MAX as u64 / 2;
        self.spacing =
            (self.progressed.saturating_sub(self.course.began_ns) / half).max(self.spacing * 2);
        let (spacing, mut last) = (self.spacing, None);
        self.course.points.retain(|(at, _)| {
            let stays = last.is_none_or(|last| at - last >= spacing);
            last = if stays { Some(*at) } else { last };
            stays
        });
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
