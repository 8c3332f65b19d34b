//! Time in which only a window's owner should be served on its CPU.
//!
//! A host's CPU is interrupted by its timers, whatever runs on it. Most of those can be placed:
//! a Linux guest's deadlines, which KVM keeps as timers of the host, and Takt's own. An
//! interrupt that falls onto a release moves it, one that falls into a window makes a scan longer.
//! So each window has a *quiet time*, from shortly before its guard to its end, and what can be chosen
//! is chosen outside of all of them: [`QuietTimes::defer`] for the deadlines of a guest,
//! [`QuietTimes::roomy`] for timers of our own, [`tick_phase`] for the host's tick, which is where
//! it is, so that the epoch has to be chosen.
//!
//! A deadline is only ever moved to later, to the first instant that is in no quiet time,
//! also across frames and a switch of schedules. Where there is none it stays where it is.

use crate::switch::Switch;
use crate::table::{Cpu, PartitionId, Table, guard_of};
use crate::time::Nanos;

/// Quiet time before a guard: longer than an interrupt of a timer takes, so that one which comes
/// just before the quiet time does not delay the owner's wake-up at the start of its guard. 5.8 us have been seen.
pub(crate) const LEAD: Nanos = Nanos::from_micros(10);
/// How long before its instant KVM may let a guest's deadline expire
/// (`LAPIC_TIMER_ADVANCE_NS_MAX`, arch/x86/kvm/lapic.c).
const TAIL: Nanos = Nanos::from_micros(5);
/// Longer than a thread that wakes only to sleep again has the processor: 3.5 us in the lab.
pub const WAKE_UP: Nanos = Nanos::from_micros(5);
/// Windows that are gone back over in search of a gap.
const WINDOWS_BACK: usize = 16;
/// Blocks that are left in turn in search of a gap. More than one after another only happens from
/// one frame to the next, so this many frames have none.
const BLOCKS_MAX: usize = 8;

/// A window with its quiet time, in ns from the start of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Quiet {
    /// Start of the quiet time; negative if it lies in the frame before.
    from: i64,
    /// The window's own start.
    start: i64,
    /// The window's own end.
    end: i64,
    /// End of the quiet time.
    to: i64,
    /// End of the last quiet time of the frame that is reached from this one without a gap.
    until: i64,
}

/// The quiet times of the windows on one CPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct QuietTimes {
    frame: i64,
    /// By schedule, in order of time.
    schedules: Box<[Box<[Quiet]>]>,
}

/// Position of a window: the number of its frame, and its place there.
type Place = (i128, usize);

impl QuietTimes {
    /// Those of the windows on `cpu` but for `except`'s own; `None` if there are none.
    pub(crate) fn new(
        tables: &[Table],
        cpu: Cpu,
        except: Option<PartitionId>,
    ) -> Option<QuietTimes> {
        let frame = signed(tables.first()?.frame());
        let schedules: Box<[_]> = tables.iter().map(|t| quiet_in(t, cpu, except)).collect();
        let any = schedules.iter().any(|windows| !windows.is_empty());
        any.then_some(QuietTimes { frame, schedules })
    }

    /// Where a guest's `deadline` is to be put, if not where it is: the first instant after it in
    /// no quiet time. Both instants are given since the epoch.
    ///
    /// `now` is when the guest was seen to run. A window that is open then has been given back, since
    /// its owner would run instead: the rest of it is free. A deadline that has passed is never moved,
    /// nor one behind which no gap is found.
    #[must_use]
    pub fn defer(&self, deadline: Nanos, now: Nanos, switch: Switch) -> Option<Nanos> {
        if deadline <= now {
            return None;
        }
        let open = self.window_at(i128::from(now.0), switch);
        let free = self.next_but(i128::from(deadline.0), open, switch)?;
        let free = Nanos(u64::try_from(free).ok()?);
        (free > deadline).then_some(free)
    }

    /// The first instant from `at` on that is in no quiet time; `None` if there is no gap.
    #[must_use]
    pub fn next(&self, at: Nanos, switch: Switch) -> Option<Nanos> {
        let next = self.next_but(i128::from(at.0), None, switch)?;
        u64::try_from(next).ok().map(Nanos)
    }

    /// An instant soon after `at` that lies at least `room` off any quiet time, or in the middle of
    /// a gap that is too narrow for that. `None` if there is no gap.
    #[must_use]
    pub fn roomy(&self, at: Nanos, room: Nanos, switch: Switch) -> Option<Nanos> {
        let at = i128::from(at.0);
        let wide = 2 * i128::from(room.0);
        let mut from = self.next_but(at, None, switch)?;
        let mut to = self.gap_end(from, switch);
        if from == at && to - from < wide {
            from = self.next_but(to, None, switch)?;
            to = self.gap_end(from, switch);
        }
        u64::try_from(from + (to - from).min(wide) / 2).ok().map(Nanos)
    }

    /// The last instant up to `at` from which `room` is over before a quiet time begins; `None` if there is no
    /// such gap close before it, or none since the epoch.
    #[must_use]
    pub fn before(&self, at: Nanos, room: Nanos, switch: Switch) -> Option<Nanos> {
        let mut at = i128::from(at.0);
        for _ in 0..WINDOWS_BACK {
            match self.quiet_from(at, room, switch) {
                None => return u64::try_from(at).ok().map(Nanos),
                Some(from) => at = from - i128::from(room.0) - 1,
            }
        }
        None
    }

    /// Where the quiet time begins that `at`, or what comes up to `room` after it, lies in.
    fn quiet_from(&self, at: i128, room: Nanos, switch: Switch) -> Option<i128> {
        let frame = at.div_euclid(i128::from(self.frame));
        [frame - 1, frame, frame + 1].into_iter().find_map(|frame| {
            let (windows, base) = self.in_frame(frame, switch)?;
            let within = i64::try_from(at - base).ok()?;
            let window = windows.get(windows.partition_point(|window| window.to <= within))?;
            let reached = within.saturating_add(signed(room)) >= window.from;
            reached.then_some(base + i128::from(window.from))
        })
    }

    fn next_but(&self, at: i128, but: Option<Place>, switch: Switch) -> Option<i128> {
        let mut at = at;
        for _ in 0..BLOCKS_MAX {
            match self.block_end(at, but, switch) {
                None => return Some(at),
                Some(end) => at = end,
            }
        }
        None
    }

    /// Where the block ends that `at` lies in; the windows up to `but` do not count.
    fn block_end(&self, at: i128, but: Option<Place>, switch: Switch) -> Option<i128> {
        let frame = at.div_euclid(i128::from(self.frame));
        // A quiet time may begin in the frame before its own and end in the one after it.
        [frame - 1, frame, frame + 1].into_iter().find_map(|frame| {
            let (windows, base) = self.in_frame(frame, switch)?;
            let within = i64::try_from(at - base).ok()?;
            let over = match but {
                Some((open, _)) if frame < open => return None,
                Some((open, place)) if frame == open => place + 1,
                _ => 0,
            };
            let first = windows.partition_point(|window| window.to <= within).max(over);
            let window = windows.get(first).filter(|window| window.from <= within)?;
            Some(base + i128::from(window.until))
        })
    }

    /// Where the gap ends that `at` lies in, or a frame after it if not earlier.
    fn gap_end(&self, at: i128, switch: Switch) -> i128 {
        let frame = at.div_euclid(i128::from(self.frame));
        let starts = [frame, frame + 1, frame + 2].into_iter().filter_map(|frame| {
            let (windows, base) = self.in_frame(frame, switch)?;
            let within = i64::try_from(at - base).ok()?;
            let window = windows.iter().find(|window| window.from > within)?;
            Some(base + i128::from(window.from))
        });
        let far = at + i128::from(self.frame);
        starts.min().unwrap_or(far).min(far)
    }

    /// The window, without its guard, that is open at an instant.
    fn window_at(&self, at: i128, switch: Switch) -> Option<Place> {
        let frame = at.div_euclid(i128::from(self.frame));
        let (windows, base) = self.in_frame(frame, switch)?;
        let within = i64::try_from(at - base).ok()?;
        let first = windows.partition_point(|window| window.end <= within);
        windows.get(first).filter(|window| window.start <= within).map(|_| (frame, first))
    }

    /// The windows of a frame, and its start. There are none before the epoch.
    fn in_frame(&self, frame: i128, switch: Switch) -> Option<(&[Quiet], i128)> {
        let schedule = switch.schedule_of(u64::try_from(frame).ok()?);
        Some((&self.schedules[schedule.0], frame * i128::from(self.frame)))
    }
}

/// The quiet times of one schedule.
fn quiet_in(table: &Table, cpu: Cpu, except: Option<PartitionId>) -> Box<[Quiet]> {
    let windows = table.windows_on(cpu).filter(|window| Some(window.partition) != except);
    let mut quiet: Vec<Quiet> = windows
        .map(|window| {
            let guard = guard_of(table.placements(), window);
            let (start, end) = (signed(window.offset), signed(window.end()));
            let (from, to) = (start - signed(guard) - signed(LEAD), end + signed(TAIL));
            Quiet { from, start, end, to, until: to }
        })
        .collect();
    for i in (1..quiet.len()).rev() {
        if quiet[i].from <= quiet[i - 1].to {
            quiet[i - 1].until = quiet[i].until;
        }
    }
    quiet.into()
}

/// What can be kept clear of the host's tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clear {
    /// All windows, from their guards to their ends.
    Windows,
    /// The releases, while some tick falls into some window.
    Releases,
}

/// Where the host's tick should lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickPhase {
    /// Time from the epoch to a tick, or to where one would be.
    pub offset: Nanos,
    /// How far ticks may creep, in either direction, until one meets what is clear.
    pub margin: Nanos,
    /// Ticks come at `offset` and at multiples of this from it, as far as the frame is concerned.
    pub step: Nanos,
    /// What is clear of them.
    pub clear: Clear,
}

/// The place of the host's tick that is farthest from all windows of these CPUs under all schedules,
/// or from their releases, where each place meets some window. `None` where ticks of that period
/// meet releases wherever they lie, or there are no windows.
#[must_use]
pub fn tick_phase(all: &[QuietTimes], period: Nanos) -> Option<TickPhase> {
    let frame = all.first()?.frame;
    let step = greatest_divisor(frame, signed(period));
    let of = |span: fn(&Quiet) -> (i64, i64)| {
        let windows = all.iter().flat_map(|quiet| quiet.schedules.iter().flatten());
        widest_gap(windows.map(span), step)
    };
    let whole = of(|window| (window.from, window.to)).map(|gap| (gap, Clear::Windows));
    let releases = || of(|window| (window.from, window.start)).map(|gap| (gap, Clear::Releases));
    let ((from, length), clear) = whole.or_else(releases)?;
    Some(TickPhase {
        offset: unsigned((from + length / 2).rem_euclid(step)),
        margin: unsigned(length / 2),
        step: unsigned(step),
        clear,
    })
}

/// Start and length of the widest gap that `spans` leave on a circle of this length.
fn widest_gap(spans: impl Iterator<Item = (i64, i64)>, circle: i64) -> Option<(i64, i64)> {
    let mut folded = Vec::new();
    for (from, to) in spans {
        if to - from >= circle {
            return None;
        }
        let start = from.rem_euclid(circle);
        folded.push((start, start + to - from));
    }
    folded.sort_unstable();
    let first = folded.first()?.0;
    // Once around, from the first start to where it comes again; what begins before its end and goes
    // on after it is there at the start too.
    let around = folded.iter().map(|(_, to)| to - circle).max()?;
    let mut reached = first.max(around);
    let mut widest: Option<(i64, i64)> = None;
    for (from, to) in folded.into_iter().chain([(first + circle, first + circle)]) {
        let length = from - reached;
        if length > widest.map_or(0, |(_, length)| length) {
            widest = Some((reached, length));
        }
        reached = reached.max(to);
    }
    widest
}

fn greatest_divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

/// Durations within a frame, which is at most a minute, or a period of a tick.
fn signed(time: Nanos) -> i64 {
    i64::try_from(time.0).unwrap_or(i64::MAX)
}

fn unsigned(time: i64) -> Nanos {
    Nanos(u64::try_from(time).unwrap_or(0))
}

#[cfg(test)]
#[path = "quiet_tests.rs"]
mod tests;
