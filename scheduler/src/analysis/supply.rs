//! What the windows give: execution time as a function of time.
//!
//! All questions are answered from one function, the supply from the epoch to an instant, and its
//! inverse. Both are a division by the frame and a search among the windows of one frame, so an
//! instant years ahead costs as much as one in the first frame, and is as exact.

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

/// The usable part of a window, in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    start: Nanos,
    end: Nanos,
    /// What the slots before it in the frame give.
    before: Nanos,
}

/// The execution time that a partition gets, for ever. Instants are given since the epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Supply {
    frame: Nanos,
    /// What all slots of a frame give; never zero.
    per_frame: Nanos,
    /// In order of time, none of them empty.
    slots: Box<[Slot]>,
    /// Where windows begin in a frame, those that give nothing included.
    starts: Box<[Nanos]>,
}

impl Supply {
    /// The supply of `partition`, with `overhead` lost at the start of each of its windows. A
    /// window that is not longer than the overhead gives nothing.
    ///
    /// # Errors
    /// If there would be no supply at all, see [`SupplyError`].
    pub fn of(
        table: &Table,
        partition: PartitionId,
        overhead: Nanos,
    ) -> Result<Supply, SupplyError> {
        if table.windows_of(partition).next().is_none() {
            return Err(SupplyError::NoWindows { partition });
        }
        let mut per_frame = Nanos::ZERO;
        let mut slots = Vec::new();
        let mut starts = Vec::new();
        for window in table.windows_of(partition) {
            starts.push(window.offset);
            let (start, end) = (window.offset.plus(overhead), window.end());
            if start < end {
                slots.push(Slot { start, end, before: per_frame });
                per_frame = per_frame.plus(end.less(start));
            }
        }
        if slots.is_empty() {
            return Err(SupplyError::NothingLeft { partition, overhead });
        }
        Ok(Supply { frame: table.frame(), per_frame, slots: slots.into(), starts: starts.into() })
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

    /// Supply between two instants; zero if `to` is not after `from`.
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

    /// The smallest supply in any interval of this length: the supply bound function.
    ///
    /// Only intervals that start just as a window closes need to be looked at. One that starts in
    /// a window can be moved later, to where that window ends: its head gives up all of the way,
    /// its tail gains no more. One that starts in a gap can be moved earlier, to where the gap
    /// starts: its head gains nothing. Neither move adds to the supply.
    #[must_use]
    pub fn minimum(&self, length: Nanos) -> Nanos {
        let frames = Nanos(length.0 / self.frame.0 * self.per_frame.0);
        let rest = Nanos(length.0 % self.frame.0);
        let least = self.slots.iter().map(|slot| self.available(slot.end, slot.end.plus(rest)));
        frames.plus(least.min().unwrap_or(Nanos::ZERO))
    }

    /// The longest time that `demand` takes to be supplied, whenever it starts: the inverse of
    /// [`minimum`](Self::minimum). `None` if that is beyond the type's 584 years.
    #[must_use]
    pub fn longest(&self, demand: Nanos) -> Option<Nanos> {
        self.slots.iter().try_fold(Nanos::ZERO, |longest, slot| {
            Some(longest.max(self.finish(slot.end, demand)?.less(slot.end)))
        })
    }

    /// The smallest supply in any interval of this length that begins with a window.
    #[must_use]
    pub fn minimum_from_start(&self, length: Nanos) -> Nanos {
        let after = self.starts.iter().map(|start| self.available(*start, start.plus(length)));
        after.min().unwrap_or(Nanos::ZERO)
    }

    /// The longest time that `demand` takes to be supplied from the beginning of any window. `None` if that
    /// is beyond the type's 584 years.
    #[must_use]
    pub fn longest_from_start(&self, demand: Nanos) -> Option<Nanos> {
        self.starts.iter().try_fold(Nanos::ZERO, |longest, start| {
            Some(longest.max(self.finish(*start, demand)?.less(*start)))
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
