//! The releases of one owner, for ever, whatever schedules come and go.
//!
//! An owner is a partition, or a CPU whose windows have to be ended. It stands at a [`Slot`] and
//! asks for the next one; it remembers only that slot. A release's instant is computed from the
//! number of its frame alone, so that no release depends on when an earlier one took place.

use crate::switch::Switch;
use crate::table::ScheduleId;
use crate::time::Nanos;

/// One release: the start of a window, in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Release {
    /// Counts the owner's windows since the epoch, from 0.
    pub sequence: u64,
    /// The schedule that it belongs to.
    pub schedule: ScheduleId,
    /// Position among the owner's windows in a frame of that schedule.
    pub window: usize,
    /// Number of the major frame, from 0.
    pub frame: u64,
    /// Start of the window, since the epoch.
    pub start: Nanos,
    /// End of the window, since the epoch.
    pub end: Nanos,
}

/// A frame in whose schedule the owner has no window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Idle {
    /// Sequence number of the release that comes next, whenever that is.
    pub sequence: u64,
    /// Number of the major frame.
    pub frame: u64,
    /// Its start, since the epoch. The frame after it must not be planned earlier.
    pub start: Nanos,
}

/// Where an owner stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// At a window.
    Window(Release),
    /// In a frame without one.
    Idle(Idle),
}

impl Slot {
    const fn frame(&self) -> u64 {
        match self {
            Slot::Window(release) => release.frame,
            Slot::Idle(idle) => idle.frame,
        }
    }

    /// Sequence number of the release at or after this slot.
    #[must_use]
    pub const fn sequence(&self) -> u64 {
        match self {
            Slot::Window(release) => release.sequence,
            Slot::Idle(idle) => idle.sequence,
        }
    }
}

/// Start and end of a window, from the start of the frame.
type Span = (Nanos, Nanos);

/// The windows of one owner under each schedule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timetable {
    frame: Nanos,
    /// By [`ScheduleId`], in order of time; not all of them empty.
    schedules: Box<[Box<[Span]>]>,
}

impl Timetable {
    pub(crate) fn new(frame: Nanos, schedules: Box<[Box<[Span]>]>) -> Timetable {
        Timetable { frame, schedules }
    }

    /// Length of the major frame.
    #[must_use]
    pub const fn frame(&self) -> Nanos {
        self.frame
    }

    /// The slot at the epoch.
    #[must_use]
    pub fn first(&self, switch: Switch) -> Slot {
        self.at(0, 0, 0, switch)
    }

    /// The slot after `slot`, which must not lie in a frame that has yet to begin (but for the
    /// guard before it; see [`crate::switch`]).
    #[must_use]
    pub fn after(&self, slot: &Slot, switch: Switch) -> Slot {
        match slot {
            Slot::Window(r) => {
                let sequence = r.sequence.saturating_add(1);
                if r.window + 1 < self.schedules[r.schedule.0].len() {
                    self.window(sequence, r.schedule, r.window + 1, r.frame)
                } else {
                    self.at(sequence, r.frame.saturating_add(1), 0, switch)
                }
            }
            Slot::Idle(idle) => self.at(idle.sequence, idle.frame.saturating_add(1), 0, switch),
        }
    }

    /// The first slot after `slot` whose window ends after `now`, since the epoch. Takes the same
    /// time however far ahead that is: a late host never loops to catch up. The sequence number
    /// counts what was passed, under the schedules of `switch`.
    #[must_use]
    pub fn catch_up(&self, slot: &Slot, now: Nanos, switch: Switch) -> Slot {
        let next = self.after(slot, switch);
        let frame = now.0 / self.frame.0;
        if next.frame() > frame {
            return next;
        }
        let schedule = switch.schedule_of(frame);
        let within = Nanos(now.0 % self.frame.0);
        let windows = &self.schedules[schedule.0];
        let over = windows.iter().take_while(|(_, end)| *end <= within).count();
        let (into, counted) = match next {
            Slot::Window(release) if release.frame == frame => (release.window, 0),
            Slot::Window(release) => {
                let rest = self.schedules[release.schedule.0].len() - release.window;
                (0, rest as u64 + self.between(release.frame + 1, frame, switch))
            }
            Slot::Idle(idle) => (0, self.between(idle.frame, frame, switch)),
        };
        let passed = counted.saturating_add((over.max(into) - into) as u64);
        self.at(next.sequence().saturating_add(passed), frame, over.max(into), switch)
    }

    /// Windows in the frames from `from` up to, but not including, `to`.
    fn between(&self, from: u64, to: u64, switch: Switch) -> u64 {
        let turn = switch.frame.clamp(from, to.max(from));
        let count =
            |frames: u64, id: ScheduleId| frames.saturating_mul(self.schedules[id.0].len() as u64);
        count(turn - from, switch.before)
            .saturating_add(count(to.saturating_sub(turn), switch.after))
    }

    /// The `window`-th window of `frame`, or what comes instead where there is none.
    fn at(&self, sequence: u64, frame: u64, window: usize, switch: Switch) -> Slot {
        let schedule = switch.schedule_of(frame);
        let count = self.schedules[schedule.0].len();
        if window < count {
            return self.window(sequence, schedule, window, frame);
        }
        if count == 0 {
            let start = Nanos(frame.saturating_mul(self.frame.0));
            return Slot::Idle(Idle { sequence, frame, start });
        }
        self.at(sequence, frame.saturating_add(1), 0, switch)
    }

    fn window(&self, sequence: u64, schedule: ScheduleId, window: usize, frame: u64) -> Slot {
        let (start, end) = self.schedules[schedule.0][window];
        let base = Nanos(frame.saturating_mul(self.frame.0));
        let (start, end) = (base.plus(start), base.plus(end));
        Slot::Window(Release { sequence, schedule, window, frame, start, end })
    }

    /// Length of the longest window.
    #[must_use]
    pub fn longest(&self) -> Nanos {
        let windows = self.schedules.iter().flatten();
        windows.map(|(start, end)| end.less(*start)).max().unwrap_or(Nanos::ZERO)
    }

    /// Shortest time from the start of one window to the start of the next, also across a switch.
    #[must_use]
    pub fn shortest_period(&self) -> Nanos {
        self.shortest(|(start, _)| start)
    }

    /// Shortest time from the end of one window to the end of the next, also across a switch.
    #[must_use]
    pub fn shortest_between_ends(&self) -> Nanos {
        self.shortest(|(_, end)| end)
    }

    /// Longest time from the end of one window to the end of the next, also across a switch.
    #[must_use]
    pub fn longest_between_ends(&self) -> Nanos {
        self.distances(|(_, end)| end).max().unwrap_or(self.frame)
    }

    fn shortest(&self, instant: fn(Span) -> Nanos) -> Nanos {
        self.distances(instant).min().unwrap_or(self.frame)
    }

    /// From each window to those that may be next.
    fn distances(&self, instant: fn(Span) -> Nanos) -> impl Iterator<Item = Nanos> {
        let within = self.schedules.iter().flat_map(move |windows| {
            windows.windows(2).map(move |pair| instant(pair[1]).less(instant(pair[0])))
        });
        let lasts = self.schedules.iter().filter_map(|windows| windows.last());
        let across = lasts.flat_map(move |&last| {
            let firsts = self.schedules.iter().filter_map(|windows| windows.first());
            firsts.map(move |&first| self.frame.plus(instant(first)).less(instant(last)))
        });
        within.chain(across)
    }
}

#[cfg(test)]
#[path = "timetable_tests.rs"]
mod tests;
