//! The scheduler's errors in terms of the file: which lines contradict each other, and what to do.

use takt_scheduler::schedules::{SCHEDULES_MAX, ScheduleId, SchedulesError};
use takt_scheduler::table::{
    Cpu, FRAME_MAX, FRAME_MIN, KICK_TIME, TableError, WINDOW_MIN, WINDOWS_MAX, Window,
};
use takt_scheduler::time::Nanos;

use super::diagnostic::{Diagnostic, Span, quote};
use super::raw;
use super::schedules::{Draft, Lines};

impl Draft<'_> {
    /// Explains an error of the schedules that were made of this draft.
    pub fn explain(&self, error: SchedulesError) -> Diagnostic {
        let found = error.to_string();
        match error {
            SchedulesError::Count { .. } => {
                let allowed = format!("1 to {SCHEDULES_MAX} tables [[schedule]]");
                match self.schedules.get(SCHEDULES_MAX) {
                    Some(excess) => Diagnostic::new(excess.header.clone(), found, allowed),
                    None => {
                        let found = "the system has no schedule";
                        Diagnostic::new(self.header.clone(), found, allowed)
                    }
                }
            }
            SchedulesError::Table { schedule, error } => {
                let lines = &self.schedules[schedule.0];
                InSchedule { draft: self, lines }.explain(error)
            }
            SchedulesError::Empty { schedule } => {
                let allowed = "at least one window in each of several schedules: who asks for \
                               another schedule has to run";
                Diagnostic::new(self.schedules[schedule.0].header.clone(), found, allowed)
            }
            SchedulesError::NeverRuns { partition } => {
                let owner = &self.partitions[partition.0];
                let allowed = format!(
                    "a [[schedule.window]] with `partition = {}` in at least one schedule, \
                     or for a \"linux\" `background = true`",
                    quote(&owner.partition.name)
                );
                Diagnostic::new(owner.name.clone(), found, allowed)
            }
            SchedulesError::NoRoomAtSwitch { from, to, cpu, room, gap, .. } => {
                self.no_room_at_switch(found, [from, to], cpu, room.less(gap))
            }
        }
    }

    /// `missing` is what the gap lacks.
    fn no_room_at_switch(
        &self,
        found: String,
        [from, to]: [ScheduleId; 2],
        cpu: Cpu,
        missing: Nanos,
    ) -> Diagnostic {
        let frame = self.frame.get_ref().0;
        let on_cpu = |schedule: ScheduleId| {
            let lines = &self.schedules[schedule.0];
            let raw = lines.raw.iter().map(|raw| &raw.get_ref().0);
            lines
                .windows
                .iter()
                .zip(raw)
                .filter(|(w, _)| self.partitions[w.partition.0].partition.cpu == cpu)
        };
        let end = |w: &Window| w.end().plus(frame.less(w.period));
        let first = on_cpu(to).min_by_key(|(w, _)| w.offset);
        let last = on_cpu(from).max_by_key(|(w, _)| end(w));
        // The scheduler has found both.
        let (Some((first, first_raw)), Some((last, last_raw))) = (first, last) else {
            return Diagnostic::new(self.header.clone(), found, "room for the guard at a switch");
        };
        let [from, to] = [from, to].map(|s| quote(self.schedules[s.0].name.get_ref()));
        let allowed = format!(
            "in {to} this window at {} or later, in {from} the last window ending at {} or \
             earlier, or a shorter `release_guard` of {}",
            first.offset.plus(missing),
            end(last).less(missing),
            quote(&self.partitions[first.partition.0].partition.name)
        );
        let label = format!("the last window of the CPU in {from}{}", repeating(last, frame));
        Diagnostic::new(first_raw.offset.span(), found, allowed)
            .and(last_raw.duration.span(), label)
    }
}

/// Says that a window is not alone in the frame.
fn repeating(window: &Window, frame: Nanos) -> String {
    if window.period == frame {
        String::new()
    } else {
        format!(", which repeats every {}", window.period)
    }
}

/// One schedule, in which windows are known by their positions.
struct InSchedule<'a> {
    draft: &'a Draft<'a>,
    lines: &'a Lines<'a>,
}

impl InSchedule<'_> {
    fn raw(&self, window: usize) -> &raw::Window {
        &self.lines.raw[window].get_ref().0
    }

    /// Where a window's period is given, or else its table.
    fn period(&self, window: usize) -> Span {
        let period = self.raw(window).period.as_ref();
        period.map_or_else(|| self.lines.raw[window].span(), toml::Spanned::span)
    }

    fn owner(&self, window: usize) -> &super::partition::Checked {
        &self.draft.partitions[self.lines.windows[window].partition.0]
    }

    fn explain(&self, error: TableError) -> Diagnostic {
        let frame = self.draft.frame;
        let found = error.to_string();
        match error {
            TableError::Frame { .. } => {
                Diagnostic::new(frame.span(), found, format!("{FRAME_MIN} to {FRAME_MAX}"))
            }
            TableError::NoSuchPartition { window } => {
                Diagnostic::new(self.raw(window).partition.span(), found, "a partition's name")
            }
            TableError::TooShort { window, .. } => {
                let allowed = format!("at least {WINDOW_MIN}");
                Diagnostic::new(self.raw(window).duration.span(), found, allowed)
            }
            TableError::Period { window, frame: length, .. } => {
                let allowed = format!("a period of which {length} is a whole multiple");
                Diagnostic::new(self.period(window), found, allowed)
                    .and(frame.span(), "the major frame")
            }
            TableError::TooMany { window } => {
                let allowed =
                    format!("at most {WINDOWS_MAX} in each schedule, repetitions counted");
                Diagnostic::new(self.period(window), found, allowed)
            }
            TableError::PastFrame { window, frame: length, .. } => {
                self.past(window, length, found, "major frame").and(frame.span(), "the major frame")
            }
            TableError::PastPeriod { window, period, .. } => {
                self.past(window, period, found, "period").and(self.period(window), "its period")
            }
            TableError::Overlap { earlier, later, end, start } => {
                self.overlap(earlier, later, end, start, found)
            }
            TableError::NoRoomForGuard { window, before, room, .. } => {
                self.no_room(window, before, room, found)
            }
            TableError::BackgroundWindow { window } => {
                let owner = self.owner(window);
                let allowed = "no window for a background partition, or `background = false`";
                Diagnostic::new(self.raw(window).partition.span(), found, allowed)
                    .and(owner.background.clone().unwrap_or(owner.header.clone()), "it is one")
            }
        }
    }

    /// A window that ends after `limit`, the length of the frame or of its period.
    fn past(&self, window: usize, limit: Nanos, found: String, what: &str) -> Diagnostic {
        let Window { offset, .. } = self.lines.windows[window];
        let rest = limit.less(offset);
        let (span, at_most) = if rest < WINDOW_MIN {
            let latest = limit.less(WINDOW_MIN);
            (self.raw(window).offset.span(), format!("the latest offset is {latest}"))
        } else {
            (self.raw(window).duration.span(), format!("at offset {offset} at most {rest}"))
        };
        Diagnostic::new(span, found, format!("windows that end within the {what}; {at_most}"))
    }

    fn overlap(
        &self,
        earlier: usize,
        later: usize,
        end: Nanos,
        start: Nanos,
        mut found: String,
    ) -> Diagnostic {
        let frame = self.draft.frame.get_ref().0;
        let [a, b] = [earlier, later].map(|window| &self.lines.windows[window]);
        let allowed = if a.period == frame && b.period == frame {
            format!("this one from {end} on, or the other one shorter")
        } else {
            "each repetition too clear of all others".to_owned()
        };
        if start != b.offset {
            found.push_str(&format!("; it is a repetition of the one at {}", b.offset));
        }
        let allowed = format!("windows on one CPU one after another: {allowed}");
        Diagnostic::new(self.raw(later).offset.span(), found, allowed).and(
            self.raw(earlier).duration.span(),
            format!("the other window{}", repeating(a, frame)),
        )
    }

    fn no_room(&self, window: usize, before: usize, room: Nanos, found: String) -> Diagnostic {
        let frame = self.draft.frame.get_ref().0;
        let [w, b] = [window, before].map(|window| &self.lines.windows[window]);
        let kick = if w.partition == b.partition {
            String::new()
        } else {
            format!(", and behind another partition {KICK_TIME} for a kick")
        };
        let allowed = format!(
            "a gap of at least {room} before this window of {}: its `release_guard`{kick}",
            quote(&self.owner(window).partition.name)
        );
        let label = if before == window {
            let earlier = if w.period == frame { "frame" } else { "period" };
            format!("the window before it is itself, a {earlier} earlier")
        } else if w.period == frame && b.period == frame && b.offset > w.offset {
            "the window before it, in the frame before".to_owned()
        } else {
            format!("the window before it{}", repeating(b, frame))
        };
        Diagnostic::new(self.raw(window).offset.span(), found, allowed)
            .and(self.raw(before).duration.span(), label)
    }
}
