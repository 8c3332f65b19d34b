//! What the windows give: execution time as a function of time.
//!
//! All questions are answered from one function, the supply from the epoch to an instant, and its
//! inverse. Both are a division by the frame and a search among the windows of one frame, so an
//! instant years ahead costs as much as one in the first frame, and is as exact.
//!
//! # Interrupts
//!
//! A window loses the wake-up's share at its start, and up to *i* to interrupts, anywhere. That function takes *i* as lost
//! right behind the wake-up. So it is at most what an interval gets that begins outside of windows, or with one: each of its
//! windows loses no less, and no later, than it really does.
//!
//! An interval that begins inside a window at *s* may lose *i* after *s*, of which the function knows nothing. It gets at least
//! as much as one that begins at the window's end *e* and is shorter by *i*. If *s* is in the last *i* of the window, it reaches
//! as far as that one or further. If *s* is earlier by *d*, it gets at least *d* before *e*, and what it reaches less far behind
//! *e* is *d*. While the wake-up still has its share it gets no less than from the window's start.

use thiserror::Error;

use crate::table::{PartitionId, Table};
use crate::time::Nanos;

/// Why a partition has no supply.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SupplyError {
    /// The partition has no windows: it is the background, or the table does not have it.
    #[error("the partition has no windows, so nothing is promised to it at a certain time")]
    NoWindows {
        /// The partition.
        partition: PartitionId,
    },
    /// The overhead leaves nothing of any window.
    #[error("the overhead of {overhead} at the start of each window leaves nothing of any of them")]
    NothingLeft {
        /// The partition.
        partition: PartitionId,
        /// The overhead.
        overhead: Nanos,
    },
}

/// Where an interval may begin, the narrowest set of instants first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Start {
    /// At the beginning of windows.
    Window,
    /// There, or between windows.
    Outside,
    /// At any time.
    Anywhere,
}

/// The usable part of a window, in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    start: Nanos,
    end: Nanos,
    /// What the slots before it in the frame give.
    before: Nanos,
}

/// A window in a frame, also one that gives nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Whole {
    start: Nanos,
    /// When the wake-up has had its share.
    awake: Nanos,
    end: Nanos,
}

/// The execution time that a partition gets, for ever. Instants are given since the epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Supply {
    frame: Nanos,
    /// What all slots of a frame give; never zero.
    per_frame: Nanos,
    /// In order of time, none of them empty.
    slots: Box<[Slot]>,
    /// In order of time.
    windows: Box<[Whole]>,
    /// What each window loses to them, anywhere in it.
    interrupts: Nanos,
}

impl Supply {
    /// The supply of `partition`. Each of its windows loses `wake_up` at its start, and `interrupts` anywhere in it. A
    /// window that is not longer than both gives nothing.
    ///
    /// # Errors
    /// If there would be no supply at all, see [`SupplyError`].
    pub fn of(
        table: &Table,
        partition: PartitionId,
        wake_up: Nanos,
        interrupts: Nanos,
    ) -> Result<Supply, SupplyError> {
        if table.windows_of(partition).next().is_none() {
            return Err(SupplyError::NoWindows { partition });
        }
        let mut per_frame = Nanos::ZERO;
        let mut slots = Vec::new();
        let mut windows = Vec::new();
        for window in table.windows_of(partition) {
            let (awake, end) = (window.offset.plus(wake_up), window.end());
            windows.push(Whole { start: window.offset, awake, end });
            let start = awake.plus(interrupts);
            if start < end {
                slots.push(Slot { start, end, before: per_frame });
                per_frame = per_frame.plus(end.less(start));
            }
        }
        if slots.is_empty() {
            return Err(SupplyError::NothingLeft { partition, overhead: wake_up.plus(interrupts) });
        }
        let (slots, windows) = (slots.into(), windows.into());
        Ok(Supply { frame: table.frame(), per_frame, slots, windows, interrupts })
    }

    /// Length of the major frame.
    #[must_use]
    pub const fn frame(&self) -> Nanos {
        self.frame
    }

    /// How many windows of a frame give something.
    pub(super) fn slots_per_frame(&self) -> usize {
        self.slots.len()
    }

    /// Supply between two instants, with all losses at the start of windows; zero if `to` is not after `from`.
    #[must_use]
    pub fn available(&self, from: Nanos, to: Nanos) -> Nanos {
        self.until(to).less(self.until(from))
    }

    /// The first instant, not before `from`, at which `demand` has been supplied since `from`.
    /// `None` if that is beyond the type's 584 years.
    #[must_use]
    pub fn finish(&self, from: Nanos, demand: Nanos) -> Option<Nanos> {
        if demand == Nanos::ZERO {
            return Some(from);
        }
        let total = self.until(from).0.checked_add(demand.0)?;
        // Supply that ends with a frame was complete when that frame's last window closed.
        let frames = (total - 1) / self.per_frame.0;
        let rest = Nanos(total - frames * self.per_frame.0);
        let after = self.slots.partition_point(|slot| slot.before < rest);
        // The first slot has nothing before it and the rest is not zero.
        let slot = self.slots[after - 1];
        let within = slot.start.plus(rest.less(slot.before));
        frames.checked_mul(self.frame.0)?.checked_add(within.0).map(Nanos)
    }

    /// Until when interrupts may hold up what begins at `instant`, beyond what [`finish`](Self::finish) knows of: it is
    /// inside of a window, and they may all come behind it. `None` if there is nothing of that.
    pub(super) fn held_up(&self, instant: Nanos) -> Option<Nanos> {
        let within = Nanos(instant.0 % self.frame.0);
        let begun = self.windows.partition_point(|window| window.awake < within);
        let window = self.windows[..begun].last().filter(|window| within < window.end)?;
        let lost = self.interrupts.min(window.end.less(within));
        (lost > Nanos::ZERO).then(|| instant.plus(lost))
    }

    /// The smallest supply in an interval of this length that begins so: the supply bound function.
    ///
    /// If it may begin in a gap, only intervals that start just as a window closes need to be looked at: one that starts
    /// in a gap can be moved earlier, to where the gap starts, and its head gains nothing. For one that may begin inside a
    /// window see the first comment of this file.
    #[must_use]
    pub fn minimum(&self, start: Start, length: Nanos) -> Nanos {
        let ends = self.slots.iter().map(|slot| slot.end);
        match start {
            Start::Window => self.least_from(self.windows.iter().map(|w| w.start), length),
            Start::Outside => self.least_from(ends, length),
            Start::Anywhere => self.least_from(ends, length.less(self.interrupts)),
        }
    }

    /// The longest time that `demand` takes to be supplied in an interval that begins so: the inverse of
    /// [`minimum`](Self::minimum). `None` if that is beyond the type's 584 years.
    #[must_use]
    pub fn longest(&self, start: Start, demand: Nanos) -> Option<Nanos> {
        let ends = self.slots.iter().map(|slot| slot.end);
        match start {
            Start::Window => self.longest_from(self.windows.iter().map(|w| w.start), demand),
            Start::Outside => self.longest_from(ends, demand),
            Start::Anywhere if demand == Nanos::ZERO => Some(Nanos::ZERO),
            Start::Anywhere => {
                let longest = self.longest_from(ends, demand)?;
                longest.0.checked_add(self.interrupts.0).map(Nanos)
            }
        }
    }

    fn least_from(&self, starts: impl Iterator<Item = Nanos>, length: Nanos) -> Nanos {
        let frames = Nanos(length.0 / self.frame.0 * self.per_frame.0);
        let rest = Nanos(length.0 % self.frame.0);
        let least = starts.map(|start| self.available(start, start.plus(rest))).min();
        frames.plus(least.unwrap_or(Nanos::ZERO))
    }

    fn longest_from(
        &self,
        mut starts: impl Iterator<Item = Nanos>,
        demand: Nanos,
    ) -> Option<Nanos> {
        starts.try_fold(Nanos::ZERO, |longest, start| {
            Some(longest.max(self.finish(start, demand)?.less(start)))
        })
    }

    /// Supply from the epoch to `instant`. No product or sum here exceeds `instant`.
    fn until(&self, instant: Nanos) -> Nanos {
        let frames = Nanos(instant.0 / self.frame.0 * self.per_frame.0);
        let within = Nanos(instant.0 % self.frame.0);
        let begun = self.slots.partition_point(|slot| slot.start <= within);
        match self.slots[..begun].last() {
            None => frames,
            Some(slot) => frames.plus(slot.before).plus(within.min(slot.end).less(slot.start)),
        }
    }
}

#[cfg(test)]
#[path = "supply_tests.rs"]
mod tests;
