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

use thiserror::Error;

use crate::time::Nanos;

/// Longest major frame that is accepted. Beyond it a "real-time" schedule is a typing mistake.
pub const FRAME_MAX: Nanos = Nanos::from_millis(60_000);
/// Shortest major frame: below it the switches alone would fill the frame.
pub const FRAME_MIN: Nanos = Nanos::from_micros(100);
/// Shortest window, for the same reason.
pub const WINDOW_MIN: Nanos = Nanos::from_micros(10);

/// A partition, by its position in the partition file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PartitionId(pub usize);

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
    /// The CPU that its vCPU thread is pinned to.
    pub cpu: Cpu,
    /// Windows or background.
    pub role: Role,
}

/// One window of the major frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Owner.
    pub partition: PartitionId,
    /// Start, from the start of the frame.
    pub offset: Nanos,
    /// Length.
    pub duration: Nanos,
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
    /// The guard before a window reaches into another window on that CPU.
    #[error(
        "the release guard of {guard} needs a gap of that length before the window, but there is {gap}"
    )]
    NoRoomForGuard {
        /// The window whose guard has no room.
        window: usize,
        /// The window before it, perhaps in the frame before.
        before: usize,
        /// The guard.
        guard: Nanos,
        /// The time between the two windows.
        gap: Nanos,
    },
    /// Two partitions want to be the background of one CPU.
    #[error("CPU {} already has a background partition", cpu.0)]
    TwoBackgrounds {
        /// The first.
        first: PartitionId,
        /// The second.
        second: PartitionId,
        /// The CPU.
        cpu: Cpu,
    },
    /// A background partition also has a window.
    #[error("a background partition has no windows: it gets all the time that they leave")]
    BackgroundWindow {
        /// The window.
        window: usize,
    },
    /// A partition that is not the background has no window: it would never run.
    #[error("the partition would never run: it has no window and is not the background")]
    NeverRuns {
        /// The partition.
        partition: PartitionId,
    },
}

/// One release of a partition: the start of one of its windows, in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Release {
    /// Counts the partition's windows since the epoch, from 0.
    pub sequence: u64,
    /// Number of the major frame, from 0.
    pub frame: u64,
    /// Start of the window, since the epoch.
    pub start: Nanos,
    /// End of the window, since the epoch.
    pub end: Nanos,
}

/// The releases of one partition, for ever.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Releases {
    frame: Nanos,
    /// Offset and end of each window, in order; never empty.
    windows: Box<[(Nanos, Nanos)]>,
}

impl Releases {
    /// The release with this sequence number.
    #[must_use]
    pub fn nth(&self, sequence: u64) -> Release {
        let per_frame = self.windows.len() as u64;
        let frame = sequence / per_frame;
        let (offset, end) = self.windows[(sequence % per_frame) as usize];
        let base = Nanos(frame.saturating_mul(self.frame.0));
        Release { sequence, frame, start: base.plus(offset), end: base.plus(end) }
    }

    /// The first release whose window ends after `now` (an offset from the epoch). Takes the
    /// same time however far ahead `now` is, so that a late host never loops to catch up.
    #[must_use]
    pub fn first_ending_after(&self, now: Nanos) -> Release {
        let frame = now.0 / self.frame.0;
        let within = Nanos(now.0 % self.frame.0);
        let over = self.windows.iter().take_while(|(_, end)| *end <= within).count();
        self.nth(frame.saturating_mul(self.windows.len() as u64).saturating_add(over as u64))
    }

    /// Length of the longest window.
    #[must_use]
    pub fn longest(&self) -> Nanos {
        self.windows.iter().map(|(offset, end)| end.less(*offset)).max().unwrap_or(Nanos::ZERO)
    }

    /// Shortest time from the end of one window to the end of the next.
    #[must_use]
    pub fn shortest_between_ends(&self) -> Nanos {
        let ends = self.windows.iter().map(|(_, end)| *end);
        let next = ends.clone().skip(1).chain([self.frame.plus(self.windows[0].1)]);
        ends.zip(next).map(|(a, b)| b.less(a)).min().unwrap_or(self.frame)
    }

    /// Shortest time from the start of one window to the start of the next.
    #[must_use]
    pub fn shortest_period(&self) -> Nanos {
        let starts = self.windows.iter().map(|(offset, _)| *offset);
        let next = starts.clone().skip(1).chain([self.frame.plus(self.windows[0].0)]);
        starts.zip(next).map(|(a, b)| b.less(a)).min().unwrap_or(self.frame)
    }
}

/// A sound schedule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    frame: Nanos,
    placements: Box<[Placement]>,
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
        for (window, w) in windows.iter().enumerate() {
            let owner =
                placements.get(w.partition.0).ok_or(TableError::NoSuchPartition { window })?;
            if owner.role == Role::Background {
                return Err(TableError::BackgroundWindow { window });
            }
            if w.duration < WINDOW_MIN {
                return Err(TableError::TooShort { window, duration: w.duration });
            }
            if w.end() > frame {
                return Err(TableError::PastFrame { window, end: w.end(), frame });
            }
        }
        check_roles(placements, windows)?;

        let mut order: Vec<usize> = (0..windows.len()).collect();
        order.sort_by_key(|&i| (placements[windows[i].partition.0].cpu, windows[i].offset));
        for on_cpu in order.chunk_by(|&a, &b| {
            placements[windows[a].partition.0].cpu == placements[windows[b].partition.0].cpu
        }) {
            check_cpu(frame, placements, windows, on_cpu)?;
        }
        Ok(Table {
            frame,
            placements: placements.into(),
            windows: order.iter().map(|&i| windows[i]).collect(),
        })
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
        let mut cpus: Vec<Cpu> = self.placements.iter().map(|p| p.cpu).collect();
        cpus.sort();
        cpus.dedup();
        cpus
    }

    /// The background partition of a CPU.
    #[must_use]
    pub fn background_of(&self, cpu: Cpu) -> Option<PartitionId> {
        let role = |p: &Placement| p.cpu == cpu && p.role == Role::Background;
        self.placements.iter().position(role).map(PartitionId)
    }

    /// The releases of a partition; `None` for a background partition, which has none.
    #[must_use]
    pub fn releases_of(&self, partition: PartitionId) -> Option<Releases> {
        self.releases(self.windows.iter().filter(|w| w.partition == partition))
    }

    /// The windows of all partitions on a CPU as one sequence, in the order of
    /// [`windows_on`](Self::windows_on); `None` where there are none.
    #[must_use]
    pub fn releases_on(&self, cpu: Cpu) -> Option<Releases> {
        self.releases(self.windows_on(cpu))
    }

    fn releases<'a>(&self, windows: impl Iterator<Item = &'a Window>) -> Option<Releases> {
        let windows: Box<[_]> = windows.map(|w| (w.offset, w.end())).collect();
        (!windows.is_empty()).then_some(Releases { frame: self.frame, windows })
    }

    /// Time per frame that is a partition's own: its windows, or for a background partition all
    /// that the windows and guards of its CPU leave, whatever their owners do.
    #[must_use]
    pub fn guaranteed(&self, partition: PartitionId) -> Nanos {
        let placement = self.placements[partition.0];
        match placement.role {
            Role::Windowed { .. } => {
                let own = self.windows.iter().filter(|w| w.partition == partition);
                own.fold(Nanos::ZERO, |sum, w| sum.plus(w.duration))
            }
            Role::Background => {
                let claimed = self.windows_on(placement.cpu).fold(Nanos::ZERO, |sum, w| {
                    sum.plus(w.duration).plus(guard_of(&self.placements, w))
                });
                self.frame.less(claimed)
            }
        }
    }
}

fn guard_of(placements: &[Placement], window: &Window) -> Nanos {
    match placements[window.partition.0].role {
        Role::Windowed { guard } => guard,
        Role::Background => Nanos::ZERO,
    }
}

/// At most one background per CPU, and nobody who never runs.
fn check_roles(placements: &[Placement], windows: &[Window]) -> Result<(), TableError> {
    for (i, p) in placements.iter().enumerate() {
        match p.role {
            Role::Background => {
                let same = |q: &Placement| q.cpu == p.cpu && q.role == Role::Background;
                if let Some(first) = placements[..i].iter().position(same) {
                    return Err(TableError::TwoBackgrounds {
                        first: PartitionId(first),
                        second: PartitionId(i),
                        cpu: p.cpu,
                    });
                }
            }
            Role::Windowed { .. } => {
                if !windows.iter().any(|w| w.partition.0 == i) {
                    return Err(TableError::NeverRuns { partition: PartitionId(i) });
                }
            }
        }
    }
    Ok(())
}

/// No overlap, and room for each guard. `order` holds the windows of one CPU by offset.
fn check_cpu(
    frame: Nanos,
    placements: &[Placement],
    windows: &[Window],
    order: &[usize],
) -> Result<(), TableError> {
    for pair in order.windows(2) {
        let (earlier, later) = (pair[0], pair[1]);
        let (end, start) = (windows[earlier].end(), windows[later].offset);
        if start < end {
            return Err(TableError::Overlap { earlier, later, end, start });
        }
    }
    // The window before the first one is the last one of the frame before.
    let before = order.iter().cycle().skip(order.len() - 1);
    for (i, (&window, &before)) in order.iter().zip(before).enumerate() {
        let guard = guard_of(placements, &windows[window]);
        let start = if i == 0 { frame } else { Nanos::ZERO }.plus(windows[window].offset);
        let gap = start.less(windows[before].end());
        if gap < guard {
            return Err(TableError::NoRoomForGuard { window, before, guard, gap });
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
