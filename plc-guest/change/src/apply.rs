//! Carries a plan out.
//!
//! Values change places with each other, so all that move are read before one is written. Three turns: what is put
//! aside and what moves is read; the state is written; the references follow. None of them can fail: what could has
//! been checked by [`Plan::parse`](crate::Plan::parse).

use crate::plan::{Plan, Step};

/// A place that a plan reads or writes, by its offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Room {
    /// The program's state.
    State(u32),
    /// The initial state of the new version. Behind the bytes of the image it is zero.
    Initial(u32),
    /// What is on its way; [`cost::GATHER_BYTES`](crate::cost::GATHER_BYTES) are enough.
    Gathered(u32),
    /// What is put aside until the change is released; [`cost::SAVED_BYTES`](crate::cost::SAVED_BYTES) are enough.
    Saved(u32),
}

/// The memory of a program, as plans see it. Ranges are inside by a checked plan's rules.
pub trait Memory {
    /// Copies bytes between rooms that do not overlap.
    fn copy(&mut self, from: Room, to: Room, bytes: u32);

    /// The number of 1, 2, 4 or 8 bytes at this place.
    fn number(&self, at: Room, bytes: u32) -> u64;

    /// Writes a number of 1, 2, 4 or 8 bytes.
    fn set_number(&mut self, at: Room, bytes: u32, value: u64);
}

/// A plan that is carried out step by step: first what the old version does not notice, in pieces, then
/// the commit.
#[derive(Clone, Copy, Debug)]
pub struct Ready<'a> {
    plan: Plan<'a>,
}

impl<'a> Ready<'a> {
    /// Of a checked plan.
    #[must_use]
    pub const fn new(plan: Plan<'a>) -> Self {
        Self { plan }
    }

    /// The plan.
    #[must_use]
    pub const fn plan(&self) -> &Plan<'a> {
        &self.plan
    }

    /// Gives at most `most` more bytes behind the old version's state their initial values. `done` have them
    /// already; returns how many do then, or none if that is all.
    pub fn prepare(&self, done: u64, most: u64, memory: &mut impl Memory) -> Option<u64> {
        let old = self.plan.old_bytes();
        let (mut skipped, mut left) = (0, most);
        for step in self.plan.steps().filter(|step| step.is_early(old)) {
            let Step::Initial { to, bytes } = step else { continue };
            let from = done.saturating_sub(skipped).min(bytes.into());
            skipped += u64::from(bytes);
            // Both are at most the step's bytes.
            let (from, count) = (from as u32, (u64::from(bytes) - from).min(left) as u32);
            if count > 0 {
                memory.copy(Room::Initial(to + from), Room::State(to + from), count);
            }
            left -= u64::from(count);
            if left == 0 {
                return Some(done + most);
            }
        }
        None
    }

    /// The commit: the state becomes that of the new version. No task of the program may have a job. Returns how
    /// many references led to something that is gone.
    pub fn apply(&self, memory: &mut impl Memory) -> u32 {
        let plan = &self.plan;
        self.gather(memory);
        let old = plan.old_bytes();
        let mut at = 0;
        let mut gone = 0;
        for step in plan.steps() {
            let bytes = step.bytes();
            match step {
                Step::Copy { to, .. } | Step::Convert { to, .. } => {
                    memory.copy(Room::Gathered(at), Room::State(to), bytes);
                    at += bytes;
                }
                Step::Initial { to, .. } if !step.is_early(old) => {
                    memory.copy(Room::Initial(to), Room::State(to), bytes);
                }
                Step::Restore { from, to, .. } => {
                    memory.copy(Room::Saved(from), Room::State(to), bytes);
                }
                Step::Reference { to, .. } => {
                    let target = memory.number(Room::Gathered(at), 8);
                    let now = plan.relocated(target);
                    gone += u32::from(target != 0 && now == 0);
                    memory.set_number(Room::State(to), 8, now);
                    at += bytes;
                }
                Step::Keep { .. } | Step::Initial { .. } | Step::Save { .. } => {}
            }
        }
        gone
    }

    /// Reads all that moves, and puts aside what a roll-back needs.
    fn gather(&self, memory: &mut impl Memory) {
        let mut at = 0;
        for step in self.plan.steps() {
            let bytes = step.bytes();
            match step {
                Step::Copy { from, .. } | Step::Reference { from, .. } => {
                    memory.copy(Room::State(from), Room::Gathered(at), bytes);
                    at += bytes;
                }
                Step::Convert { from, count, conversion, .. } => {
                    let (read, written) = (conversion.from().bytes(), conversion.to().bytes());
                    for index in 0..count {
                        let old = memory.number(Room::State(from + index * read), read);
                        let to = Room::Gathered(at + index * written);
                        memory.set_number(to, written, conversion.value(old));
                    }
                    at += bytes;
                }
                Step::Save { from, to, .. } => {
                    memory.copy(Room::State(from), Room::Saved(to), bytes);
                }
                Step::Keep { .. } | Step::Initial { .. } | Step::Restore { .. } => {}
            }
        }
    }
}
