//! RETAIN and PERSISTENT variables over a start of their program.
//!
//! Their values are kept in the program's block, outside of the state: one behind the other, in the order of the image's
//! table. Before the guest starts Takt puts into it what outlives that start. When a program alone starts anew, the kernel
//! puts the values there itself before the state gets its initial ones. Like all of a program's set-up this is done a
//! little at a time, in time that no task needs.

use super::program::{Program, STATE};
use takt_abi::memory::PAGE;
use takt_abi::program::restored;
use takt_program::{Start, Variable};

/// Variables that are looked at, and bytes that are copied, at a time; of a longer variable all.
const VARIABLES: u32 = 64;
const BYTES: u64 = PAGE;

/// How far the state of a program has been set up.
#[derive(Clone, Copy, Debug)]
pub enum Loading {
    /// Values are put into the block, from here on.
    Keep(Cursor),
    /// The state gets its initial values, from this byte on.
    Initial(u64),
    /// Values come back from the block.
    Restore(Cursor),
}

impl Loading {
    /// A program that has run starts anew.
    pub const ANEW: Self = Self::Keep(Cursor { variable: 0, at: 0 });
    /// The guest starts.
    pub const FIRST: Self = Self::Initial(0);
    const RESTORE: Self = Self::Restore(Cursor { variable: 0, at: 0 });
}

/// A place in the table of variables, and in the block.
#[derive(Clone, Copy, Debug)]
pub struct Cursor {
    variable: u32,
    at: u64,
}

impl Program {
    /// What its tasks are told of its start. A guest that starts warm tells that to programs that retain nothing, too.
    pub fn start_of(&self, guest: Start) -> Start {
        match self.restored {
            restored::ALL => Start::Warm,
            _ if self.image.retained().next().is_none() => guest,
            _ => Start::Cold,
        }
    }

    /// Does the next piece of its set-up. True if that was the last one.
    pub fn load_some(&mut self) -> bool {
        let Some(loading) = self.loading else { return false };
        self.loading = match loading {
            Loading::Keep(cursor) => {
                let next = self.carry(cursor, true);
                Some(next.map_or(Loading::Initial(0), Loading::Keep))
            }
            Loading::Initial(done) => match self.initialise(done) {
                Some(next) => Some(Loading::Initial(next)),
                None => (self.restored != restored::NOTHING).then_some(Loading::RESTORE),
            },
            Loading::Restore(cursor) => self.carry(cursor, false).map(Loading::Restore),
        };
        let done = self.loading.is_none();
        if done {
            self.inform();
        }
        done
    }

    /// Carries the values of some variables to the block, or back. Returns where it goes on.
    fn carry(&self, from: Cursor, keep: bool) -> Option<Cursor> {
        let state = self.regions[STATE].area;
        let (mut at, mut copied) = (from.at, 0);
        for index in from.variable..from.variable.saturating_add(VARIABLES) {
            let variable = self.image.variable_at(index)?;
            if !variable.is_retained() {
                continue;
            }
            let bytes = u64::from(variable.bytes);
            if copied > 0 && copied + bytes > BYTES {
                return Some(Cursor { variable: index, at });
            }
            let places = (state.part(variable.offset.into(), bytes), self.retained.part(at, bytes));
            match places {
                (Some(value), Some(kept)) if keep => kept.copy_from(value),
                (Some(value), Some(kept)) if self.takes(&variable) => value.copy_from(kept),
                _ => {}
            }
            (at, copied) = (at + bytes, copied + bytes);
        }
        Some(Cursor { variable: from.variable + VARIABLES, at })
    }

    fn takes(&self, variable: &Variable<'_>) -> bool {
        self.restored == restored::ALL || variable.is_persistent()
    }
}
