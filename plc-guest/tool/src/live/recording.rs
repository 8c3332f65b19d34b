//! A recording: the lines of values around a trigger, in their order.
//!
//! Lines before the trigger are kept in memory, as many as lie within the time that is wanted and within
//! [`KEPT_MAX`]. What comes from the trigger on goes on at once.

use std::collections::VecDeque;

use takt_scheduler::time::Nanos;

/// Most bytes of values that are kept for the time before the trigger.
pub const KEPT_MAX: usize = 64 << 20;

/// A line of values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    pub cycle: u64,
    pub release_ns: u64,
    pub unsettled: u16,
    /// The bytes of all points.
    pub bytes: Vec<u8>,
}

/// A line of the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    pub line: Line,
    /// Cycles between the row before and this one that are not in the recording.
    pub gap: u64,
}

/// What a recording has, at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    pub rows: u64,
    /// Cycles that are missing between rows.
    pub gaps: u64,
    /// When the trigger was, since the epoch of the run.
    pub triggered_ns: u64,
    /// Lines of the time before the trigger for which there was no room.
    pub not_kept: u64,
}

/// Takes lines, and gives those of the recording.
pub struct Recording {
    before: Nanos,
    after: Nanos,
    kept: VecDeque<Line>,
    kept_bytes: usize,
    triggered: Option<u64>,
    /// The cycle of the row before, and its release.
    last: Option<(u64, u64)>,
    extent: Extent,
    over: bool,
}

impl Recording {
    /// From this time before the trigger to this time after it.
    pub fn new(before: Nanos, after: Nanos) -> Self {
        Self {
            before,
            after,
            kept: VecDeque::new(),
            kept_bytes: 0,
            triggered: None,
            last: None,
            extent: Extent::default(),
            over: false,
        }
    }

    /// Takes the next line; `holds` says whether the trigger does. Returns what belongs to the recording now.
    pub fn take(&mut self, line: Line, holds: impl FnOnce(&Line) -> bool) -> Vec<Row> {
        let triggered = match self.triggered {
            Some(triggered) => triggered,
            None if holds(&line) => {
                self.triggered = Some(line.release_ns);
                self.extent.triggered_ns = line.release_ns;
                line.release_ns
            }
            None => {
                self.keep(line);
                return Vec::new();
            }
        };
        self.over = self.over || line.release_ns > triggered.saturating_add(self.after.0);
        if self.over {
            return Vec::new();
        }
        self.drop_before(triggered);
        let lines: Vec<Line> = self.kept.drain(..).chain([line]).collect();
        lines.into_iter().map(|line| self.row(line)).collect()
    }

    /// True if nothing more belongs to it.
    pub fn is_over(&self) -> bool {
        self.over
    }

    /// From the last row to the end; `None` before the trigger.
    pub fn left(&self) -> Option<Nanos> {
        let (triggered, (_, release_ns)) = self.triggered.zip(self.last)?;
        Some(Nanos(triggered.saturating_add(self.after.0).saturating_sub(release_ns)))
    }

    /// What it has.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    fn keep(&mut self, line: Line) {
        let now = line.release_ns;
        self.kept_bytes += line.bytes.len();
        self.kept.push_back(line);
        self.drop_before(now);
        while self.kept_bytes > KEPT_MAX && self.drop_one() {
            self.extent.not_kept += 1;
        }
    }

    /// Drops the lines that are older than what is wanted before this instant.
    fn drop_before(&mut self, instant: u64) {
        let since = instant.saturating_sub(self.before.0);
        while self.kept.front().is_some_and(|line| line.release_ns < since) {
            self.drop_one();
        }
    }

    fn drop_one(&mut self) -> bool {
        let line = self.kept.pop_front();
        self.kept_bytes -= line.as_ref().map_or(0, |line| line.bytes.len());
        line.is_some()
    }

    fn row(&mut self, line: Line) -> Row {
        // Takt's lines come in the order of their cycles; what comes otherwise has no gap that can be told.
        let gap =
            self.last.map_or(0, |(last, _)| line.cycle.saturating_sub(last).saturating_sub(1));
        self.last = Some((line.cycle, line.release_ns));
        self.extent.rows += 1;
        self.extent.gaps = self.extent.gaps.saturating_add(gap);
        Row { line, gap }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn line(cycle: u64) -> Line {
        Line { cycle, release_ns: cycle * MS, unsettled: 0, bytes: vec![cycle as u8; 4] }
    }

    /// The cycles of the recording, and the gaps before them.
    fn record(recording: &mut Recording, cycles: &[u64], trigger: u64) -> Vec<(u64, u64)> {
        let lines = cycles.iter().map(|cycle| line(*cycle));
        let rows = lines.flat_map(|line| recording.take(line, |line| line.cycle >= trigger));
        rows.map(|row| (row.line.cycle, row.gap)).collect()
    }

    #[test]
    fn it_reaches_from_before_the_trigger_to_after_it() {
        let mut recording = Recording::new(Nanos(2 * MS), Nanos(3 * MS));
        let cycles: Vec<u64> = (0..20).collect();
        let rows = record(&mut recording, &cycles, 10);
        assert_eq!(rows, (8..=13).map(|cycle| (cycle, 0)).collect::<Vec<_>>());
        assert!(recording.is_over());
        let extent = Extent { rows: 6, triggered_ns: 10 * MS, ..Extent::default() };
        assert_eq!(recording.extent(), extent);
    }

    #[test]
    fn gaps_are_counted_before_the_trigger_too_and_a_trigger_stays() {
        let mut recording = Recording::new(Nanos(4 * MS), Nanos(10 * MS));
        // After the trigger its condition need not hold.
        let rows = [line(1), line(7), line(9), line(10), line(15)];
        let rows = rows.into_iter().flat_map(|l| recording.take(l, |line| line.cycle == 10));
        let rows: Vec<_> = rows.map(|row| (row.line.cycle, row.gap)).collect();
        assert_eq!(rows, [(7, 0), (9, 1), (10, 0), (15, 4)]);
        assert_eq!(recording.extent().gaps, 5);
        assert!(!recording.is_over());
    }

    #[test]
    fn without_a_trigger_that_holds_only_the_last_lines_are_kept() {
        let mut recording = Recording::new(Nanos(5 * MS), Nanos(MS));
        assert!(record(&mut recording, &(0..1_000).collect::<Vec<_>>(), u64::MAX).is_empty());
        assert_eq!((recording.kept.len(), recording.kept_bytes), (6, 24));

        let mut large = Recording::new(Nanos(u64::MAX), Nanos(MS));
        for cycle in 0..10 {
            let line = Line { bytes: vec![0; KEPT_MAX / 4], ..line(cycle) };
            assert!(large.take(line, |_| false).is_empty());
            assert!(large.kept_bytes <= KEPT_MAX);
        }
        assert_eq!(large.extent().not_kept, 6);
    }

    #[test]
    fn cycles_that_go_backwards_are_no_gap() {
        let mut recording = Recording::new(Nanos(0), Nanos(u64::MAX));
        let rows = record(&mut recording, &[u64::MAX / MS, 3, 4], 0);
        assert_eq!(rows.iter().map(|row| row.1).collect::<Vec<_>>(), [0, 0, 0]);
    }
}
