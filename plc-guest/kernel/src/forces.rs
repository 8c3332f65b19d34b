//! Values that an operator keeps forced.
//!
//! A force is applied at the start of each job of its program, after the inputs are read, and at its end, before the
//! outputs are written. So a task sees the forced value at its start, and others see it after each job; what the job
//! itself does with the variable in between is the job's.

use takt_abi::live::{FORCES, Point, Refusal};
use takt_abi::program::PROGRAMS_MAX;

/// All that is forced.
#[derive(Clone, Debug)]
pub struct Forces {
    /// In the order in which they were made; the rest is none.
    all: [Option<(Point, u64)>; FORCES],
    count: u16,
    /// Of each program.
    each: [u16; PROGRAMS_MAX],
}

impl Forces {
    /// Nothing is forced.
    pub const NONE: Self = Self { all: [None; FORCES], count: 0, each: [0; PROGRAMS_MAX] };

    /// How many there are.
    #[must_use]
    pub const fn count(&self) -> u16 {
        self.count
    }

    /// True if a point of this program is forced.
    #[must_use]
    pub fn any(&self, program: u8) -> bool {
        self.each.get(usize::from(program)).is_some_and(|each| *each > 0)
    }

    /// Forces a point, or changes its value.
    ///
    /// # Errors
    /// If there is no room, or no such program.
    pub fn set(&mut self, point: Point, value: u64) -> Result<(), Refusal> {
        if let Some((_, old)) = self.all.iter_mut().flatten().find(|(p, _)| *p == point) {
            *old = value;
            return Ok(());
        }
        let each = self.each.get_mut(usize::from(point.range.program));
        let each = each.ok_or(Refusal::NoProgram)?;
        let slot = self.all.get_mut(usize::from(self.count)).ok_or(Refusal::Full)?;
        *slot = Some((point, value));
        self.count += 1;
        *each += 1;
        Ok(())
    }

    /// Forces a point no longer.
    ///
    /// # Errors
    /// If it is not forced.
    pub fn release(&mut self, point: Point) -> Result<(), Refusal> {
        let is_it = |slot: &Option<(Point, u64)>| slot.is_some_and(|(p, _)| p == point);
        let at = self.all.iter().position(is_it).ok_or(Refusal::NotForced)?;
        let end = usize::from(self.count);
        self.all.copy_within(at + 1..end, at);
        self.all[end - 1] = None;
        self.count -= 1;
        self.each[usize::from(point.range.program)] -= 1;
        Ok(())
    }

    /// Forces nothing any longer.
    pub fn clear(&mut self) {
        *self = Self::NONE;
    }

    /// Those of a program, in the order in which they were made.
    pub fn of(&self, program: u8) -> impl Iterator<Item = (Point, u64)> {
        let count = if self.any(program) { usize::from(self.count) } else { 0 };
        let all = self.all[..count].iter().copied().flatten();
        all.filter(move |(point, _)| point.range.program == program)
    }
}

#[cfg(test)]
#[path = "forces_tests.rs"]
mod tests;
