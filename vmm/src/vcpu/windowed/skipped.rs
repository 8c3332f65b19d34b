//! Releases that have passed while the thread was not there.
//!
//! They are told of as soon as it is there again, and not with its next window: there may never be one.

use takt_scheduler::time::Tsc;
use takt_scheduler::timetable::Slot;

use super::Windowed;
use crate::health::{Detail, Reporter};
use crate::vcpu::Control;
use crate::vcpu::guest::End;
use crate::vcpu::record::{Record, Skipped};

impl Windowed {
    /// Goes on from a slot that is over at this instant to the first one that is not, and tells of the releases that
    /// this passes. Returns the guest's end if its table does not let it go on after that.
    pub(super) fn pass(&mut self, due: Tsc, woken: Tsc, health: &mut Reporter) -> Option<End> {
        let from = self.slot.sequence();
        self.catch_up(woken);
        let next = self.slot.sequence();
        let count = next.saturating_sub(from);
        if count == 0 {
            return None;
        }
        self.skipped += count;
        self.log.push(Record::Skipped(Skipped { count, due, woken }));
        // Until its first scan a guest has no deadline to miss.
        if self.starting {
            return None;
        }
        health.raise(Detail::Lost(count, next - 1), 1)
    }

    /// The end of a guest that is to have this one before `slot`, for which its thread may have been too late already when
    /// it was asked to stop. What it passes after that is no lost release.
    pub(super) fn leave(
        &mut self,
        slot: Slot,
        end: End,
        control: &Control,
        health: &mut Reporter,
    ) -> End {
        let guard = self.base.frequency.ticks(self.plan.guard.length());
        let (due, over) = match slot {
            Slot::Window(release) => (self.base.instant(release.start).before(guard), release.end),
            Slot::Idle(idle) => (self.base.instant(idle.start), idle.start),
        };
        let now = control.asked_to_stop().unwrap_or_else(Tsc::now);
        if self.base.instant(over) > now {
            return end;
        }
        self.slot = slot;
        self.pass(due, now, health).unwrap_or(end)
    }
}

#[cfg(test)]
#[path = "skipped_tests.rs"]
mod tests;
