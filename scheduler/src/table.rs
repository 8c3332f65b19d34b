//! The schedule table: which partition owns a processor, as a strict function of time.
//!
//! A *major frame* repeats for ever. It holds *windows*, each of one partition; one partition per
//! CPU may be the *background*, which gets everything that no window uses. A [`Table`] exists only
//! if it is sound: building it is the validation, and what it then says needs no error case.
//!
//! A window has a *guard* before it: the host wakes the partition that much early so that the
//! wake-up's own latency is over when the release comes. The guard is time of that partition too,
//! so it may not reach into another partition's window. Windows and guards are laid on a circle,
//! since the guard of a window at offset 0 lies at the end of the frame before.
//!
//! A table is one schedule. [`crate::schedules`] puts several beside each other, and
//! [`crate::timetable`] says when the releases come.

use thiserror::Error;

use crate::time::Nanos;

/// Longest major frame that is accepted. Beyond it a "real-time" schedule is a typing mistake.
pub const FRAME_MAX: Nanos = Nanos::from_millis(60_000);
/// Shortest major frame: below it the switches alone would fill the frame.
pub const FRAME_MIN: Nanos = Nanos::from_micros(100);
/// Shortest window, for the same reason.
pub const WINDOW_MIN: Nanos = Nanos::from_micros(10);
/// Longest guard: it is taken from the others, so more than this hides a broken host.
pub const GUARD_MAX: Nanos = Nanos::from_millis(1);
/// Most windows of one schedule in a frame, repetitions counted.
pub const WINDOWS_MAX: usize = 4096;
/// How long after its window's end a partition that has to be kicked out can still hold the CPU:
/// the guest itself stops within a microsecond, its thread takes until then to fall asleep. At most
/// 26 us in the lab, see `docs/timing.md`.
pub const KICK_TIME: Nanos = Nanos::from_micros(30);
/// What the end of a window can cost the background beyond the window: a kick, the exit from the
/// guest and the way to sleep of two threads. Measured in the lab, see `docs/timing.md`.
pub const WINDOW_COST: Nanos = Nanos::from_micros(30);

/// A partition, by its position in the partition file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PartitionId(pub usize);

/// Most schedules of a system.
pub const SCHEDULES_MAX: usize = 16;

/// A schedule, by its position in the partition file. The first is the one that holds at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScheduleId(pub usize);

/// A host processor, by the number that the host's kernel gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cpu(pub usize);

/// When a partition runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// In its windows, woken `guard` before each.
    Windowed {
        /// How long before a window the host wakes the partition.
        guard: Nanos,
    },
    /// Whenever no window on its CPU uses the time.
    Background,
}

/// Where and how one partition runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// The CPU that its vCPU thread is pinned to. A background partition may have
    /// [further ones](Table::processors_of).
    pub cpu: Cpu,
    /// Windows or background.
    pub role: Role,
}

/// A window of the major frame, or one that repeats within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Owner.
    pub partition: PartitionId,
    /// Start, from the start of the frame.
    pub offset: Nanos,
    /// Length.
    pub duration: Nanos,
    /// Time from one repetition to the next; the frame, for a window that comes once in it. In a
    /// [`Table`] every window is of the latter kind.
    pub period: Nanos,
}

impl Window {
    /// End, from the start of the frame.
    #[must_use]
    pub const fn end(&self) -> Nanos {
        self.offset.plus(self.duration)
    }
}

/// Why a schedule is not sound. Windows and partitions are given by their position in the input,
/// so that a caller can point at the line they came from.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum TableError {
    /// The frame is outside [`FRAME_MIN`] to [`FRAME_MAX`].
    #[error("the major frame of {frame} is not between {FRAME_MIN} and {FRAME_MAX}")]
    Frame {
        /// What was asked for.
        frame: Nanos,
    },
    /// A window names a partition that does not exist.
    #[error("window {window} belongs to no partition")]
    NoSuchPartition {
        /// The window.
        window: usize,
    },
    /// A window is shorter than [`WINDOW_MIN`].
    #[error("the window of {duration} is shorter than the shortest allowed, {WINDOW_MIN}")]
    TooShort {
        /// The window.
        window: usize,
        /// Its length.
        duration: Nanos,
    },
    /// The frame is no multiple of a window's period.
    #[error("the period of {period} does not divide the major frame of {frame}")]
    Period {
        /// The window.
        window: usize,
        /// Its period.
        period: Nanos,
        /// The frame.
        frame: Nanos,
    },
    /// A window that repeats passes the end of its period.
    #[error("the window ends at {end}, past the end of its period of {period}")]
    PastPeriod {
        /// The window.
        window: usize,
        /// Where it ends.
        end: Nanos,
        /// Its period.
        period: Nanos,
    },
    /// More windows than [`WINDOWS_MAX`].
    #[error("there are more than {WINDOWS_MAX} windows in a major frame")]
    TooMany {
        /// The window that is one too many, or one of its repetitions is.
        window: usize,
    },
    /// A window passes the end of the frame.
    #[error("the window ends at {end}, past the end of the major frame at {frame}")]
    PastFrame {
        /// The window.
        window: usize,
        /// Where it ends.
        end: Nanos,
        /// Where the frame ends.
        frame: Nanos,
    },
    /// Two windows on one CPU share time.
    #[error("the window starts at {start}, but the one before it on this CPU ends at {end}")]
    Overlap {
        /// The earlier window.
        earlier: usize,
        /// The later one.
        later: usize,
        /// Where the earlier one ends.
        end: Nanos,
        /// Where the later one starts.
        start: Nanos,
    },
    /// The guard before a window reaches into another window on that CPU, or into the time that
    /// the end of another partition's window can take.
    #[error(
        "the release guard of {guard} needs a gap of {room} before the window, but there is {gap}"
    )]
    NoRoomForGuard {
        /// The window whose guard has no room.
        window: usize,
        /// The window before it, perhaps in the frame before.
        before: usize,
        /// The guard.
        guard: Nanos,
        /// The least time between the two windows.
        room: Nanos,
        /// The time between the two windows.
        gap: Nanos,
    },
    /// A background partition also has a window.
    #[error("a background partition has no windows: it gets all the time that they leave")]
    BackgroundWindow {
        /// The window.
        window: usize,
    },
}

/// A sound schedule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    frame: Nanos,
    placements: Box<[Placement]>,
    /// CPUs of background partitions beyond those of their placements.
    further: Box<[(PartitionId, Cpu)]>,
    /// By CPU, then by offset.
    windows: Box<[Window]>,
}

impl Table {
    /// Checks a schedule and makes it a table. `windows` may be in any order.
    ///
    /// # Errors
    /// The first rule that is broken, see [`TableError`].
    pub fn new(
        frame: Nanos,
        placements: &[Placement],
        windows: &[Window],
    ) -> Result<Table, TableError> {
        if !(FRAME_MIN..=FRAME_MAX).contains(&frame) {
            return Err(TableError::Frame { frame });
        }
        let mut expanded: Vec<(usize, Window)> = Vec::new();
        for (window, w) in windows.iter().enumerate() {
            check_window(frame, placements, window, w)?;
            let repetitions = frame.0 / w.period.0;
            if repetitions > (WINDOWS_MAX - expanded.len()) as u64 {
                return Err(TableError::TooMany { window });
            }
            expanded.extend((0..repetitions).map(|n| {
                let offset = w.offset.plus(Nanos(n * w.period.0));
                (window, Window { offset, period: frame, ..*w })
            }));
        }
        expanded.sort_by_key(|(_, w)| (placements[w.partition.0].cpu, w.offset));
        let cpu = |w: &Window| placements[w.partition.0].cpu;
        for on_cpu in expanded.chunk_by(|(_, a), (_, b)| cpu(a) == cpu(b)) {
            check_cpu(frame, placements, on_cpu)?;
        }
        Ok(Table {
            frame,
            placements: placements.into(),
            further: Box::default(),
            windows: expanded.into_iter().map(|(_, w)| w).collect(),
        })
    }

    /// The same table, with further CPUs of background partitions, each of them once.
    pub(crate) fn with_further(self, further: &[(PartitionId, Cpu)]) -> Table {
        Table { further: further.into(), ..self }
    }

    /// Length of the major frame.
    #[must_use]
    pub const fn frame(&self) -> Nanos {
        self.frame
    }

    /// Where each partition runs, by [`PartitionId`].
    #[must_use]
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// The windows on one CPU, in order of time.
    pub fn windows_on(&self, cpu: Cpu) -> impl Iterator<Item = &Window> {
        self.windows.iter().filter(move |w| self.placements[w.partition.0].cpu == cpu)
    }

    /// The CPUs that the schedule uses, in order, each once.
    #[must_use]
    pub fn cpus(&self) -> Vec<Cpu> {
        let first = self.placements.iter().map(|p| p.cpu);
        let mut cpus: Vec<Cpu> = first.chain(self.further.iter().map(|(_, cpu)| *cpu)).collect();
        cpus.sort();
        cpus.dedup();
        cpus
    }

    /// The CPUs of a partition, one for each of its processors; that of its placement first.
    pub fn processors_of(&self, partition: PartitionId) -> impl Iterator<Item = Cpu> {
        let further = self.further.iter().filter(move |(owner, _)| *owner == partition);
        let first = self.placements.get(partition.0).map(|p| p.cpu);
        first.into_iter().chain(further.map(|(_, cpu)| *cpu))
    }

    /// The background partitions of a CPU, which share what its windows leave.
    pub fn backgrounds_of(&self, cpu: Cpu) -> impl Iterator<Item = PartitionId> {
        let all = self.placements.iter().enumerate().map(|(i, p)| (PartitionId(i), p.role));
        let here = move |id| self.processors_of(id).any(|own| own == cpu);
        all.filter(move |(id, role)| *role == Role::Background && here(*id)).map(|(id, _)| id)
    }

    /// The windows of a partition, in order of time.
    pub fn windows_of(&self, partition: PartitionId) -> impl Iterator<Item = &Window> {
        self.windows.iter().filter(move |w| w.partition == partition)
    }

    /// Time per frame that the windows of a CPU, their guards and the cost of ending them ([`WINDOW_COST`])
    /// leave.
    #[must_use]
    pub fn left_on(&self, cpu: Cpu) -> Nanos {
        let claimed = self.windows_on(cpu).fold(Nanos::ZERO, |sum, w| {
            sum.plus(w.duration).plus(guard_of(&self.placements, w)).plus(WINDOW_COST)
        });
        self.frame.less(claimed)
    }

    /// Time per frame that is a partition's own, whatever the others do: its windows, or for a
    /// background partition what is [left](Self::left_on) on its CPUs. Several on one CPU have that together.
    #[must_use]
    pub fn guaranteed(&self, partition: PartitionId) -> Nanos {
        let placement = self.placements[partition.0];
        match placement.role {
            Role::Windowed { .. } => {
                self.windows_of(partition).fold(Nanos::ZERO, |sum, w| sum.plus(w.duration))
            }
            Role::Background => self
                .processors_of(partition)
                .fold(Nanos::ZERO, |sum, cpu| sum.plus(self.left_on(cpu))),
        }
    }
}

pub(crate) fn guard_of(placements: &[Placement], window: &Window) -> Nanos {
    match placements[window.partition.0].role {
        Role::Windowed { guard } => guard,
        Role::Background => Nanos::ZERO,
    }
}

/// The least time from the end of the window `before` to the start of `window`: the guard, so that
/// the release is exact, and before it the time in which another partition may have to be kicked
/// out. Without a guard nothing is promised that this could break.
pub(crate) fn room_before(placements: &[Placement], window: &Window, before: &Window) -> Nanos {
    let guard = guard_of(placements, window);
    let other = window.partition != before.partition && guard > Nanos::ZERO;
    guard.plus(if other { KICK_TIME } else { Nanos::ZERO })
}

/// What concerns one window alone.
fn check_window(
    frame: Nanos,
    placements: &[Placement],
    window: usize,
    w: &Window,
) -> Result<(), TableError> {
    let owner = placements.get(w.partition.0).ok_or(TableError::NoSuchPartition { window })?;
    if owner.role == Role::Background {
        return Err(TableError::BackgroundWindow { window });
    }
    if w.duration < WINDOW_MIN {
        return Err(TableError::TooShort { window, duration: w.duration });
    }
    if w.period == Nanos::ZERO || !frame.0.is_multiple_of(w.period.0) {
        return Err(TableError::Period { window, period: w.period, frame });
    }
    if w.end() > frame {
        return Err(TableError::PastFrame { window, end: w.end(), frame });
    }
    if w.end() > w.period {
        return Err(TableError::PastPeriod { window, end: w.end(), period: w.period });
    }
    Ok(())
}

/// No overlap, and room for each guard. `windows` are those of one CPU by offset, each with its
/// position in the input.
fn check_cpu(
    frame: Nanos,
    placements: &[Placement],
    windows: &[(usize, Window)],
) -> Result<(), TableError> {
    for pair in windows.windows(2) {
        let [(earlier, a), (later, b)] = [pair[0], pair[1]];
        let (end, start) = (a.end(), b.offset);
        if start < end {
            return Err(TableError::Overlap { earlier, later, end, start });
        }
    }
    // The window before the first one is the last one of the frame before.
    let before = windows.iter().cycle().skip(windows.len() - 1);
    for (i, (&(window, w), &(before, b))) in windows.iter().zip(before).enumerate() {
        let room = room_before(placements, &w, &b);
        let start = if i == 0 { frame } else { Nanos::ZERO }.plus(w.offset);
        let gap = start.less(b.end());
        if gap < room {
            let guard = guard_of(placements, &w);
            return Err(TableError::NoRoomForGuard { window, before, guard, room, gap });
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
