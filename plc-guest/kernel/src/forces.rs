//! Values that an operator keeps forced.
//!
//! A force is applied at the start of each job of its program, and at its end, before the outputs are written. Forced
//! inputs are applied once more after the inputs are read. So a task sees the forced value at its start, and others see it
//! after each job; what the job itself does with the variable in between is the job's.
//!
//! At most starts of jobs all forced values are in their places since the last end of a job. To put them there again would
//! take time of the guard before the release. So it is known of each program whether something has been written since.

use takt_abi::live::{Area, FORCES, Point, Refusal};
use takt_abi::program::PROGRAMS_MAX;

/// All that is forced.
#[derive(Clone, Debug)]
pub struct Forces {
    /// In the order in which they were made; the rest is none.
    all: [Option<(Point, u64)>; FORCES],
    count: u16,
    /// Of each program.
    each: [u16; PROGRAMS_MAX],
    /// Of the inputs of each program.
    inputs: [u16; PROGRAMS_MAX],
    /// Programs that have all forced values in their places, a bit for each.
    settled: u16,
}

const _: () = assert!(PROGRAMS_MAX <= u16::BITS as usize);

impl Forces {
    /// Nothing is forced.
    pub const NONE: Self = Self {
        all: [None; FORCES],
        count: 0,
        each: [0; PROGRAMS_MAX],
        inputs: [0; PROGRAMS_MAX],
        settled: 0,
    };

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

    /// Forces a point, or changes its value, which is to be put into its place.
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
        self.inputs[usize::from(point.range.program)] += is_input(&point);
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
        if self.count == 0 {
            self.settled = 0;
        }
        self.each[usize::from(point.range.program)] -= 1;
        self.inputs[usize::from(point.range.program)] -= is_input(&point);
        Ok(())
    }

    /// Forces nothing any longer.
    pub fn clear(&mut self) {
        *self = Self::NONE;
    }

    /// All forced values of a program are in their places. Not to be told while nothing is forced.
    pub fn settle(&mut self, program: u8) {
        self.settled |= bit(program);
    }

    /// Something writes into the memory of a program, and perhaps over a forced value.
    pub fn unsettle(&mut self, program: u8) {
        self.settled &= !bit(program);
    }

    /// True if nothing has been written since [`settle`](Self::settle).
    #[must_use]
    pub fn is_settled(&self, program: u8) -> bool {
        self.settled & bit(program) != 0
    }

    /// Those of a program, in the order in which they were made.
    pub fn of(&self, program: u8) -> impl Iterator<Item = (Point, u64)> {
        let count = if self.any(program) { usize::from(self.count) } else { 0 };
        let all = self.all[..count].iter().copied().flatten();
        all.filter(move |(point, _)| point.range.program == program)
    }

    /// The same, only inputs.
    pub fn inputs_of(&self, program: u8) -> impl Iterator<Item = (Point, u64)> {
        let any = self.inputs.get(usize::from(program)).is_some_and(|inputs| *inputs > 0);
        let all = any.then(|| self.of(program)).into_iter().flatten();
        all.filter(|(point, _)| point.range.area == Area::Input)
    }
}

fn is_input(point: &Point) -> u16 {
    (point.range.area == Area::Input).into()
}

/// The bit of a program; none of a number that is no program's.
const fn bit(program: u8) -> u16 {
    if (program as usize) < PROGRAMS_MAX { 1 << program } else { 0 }
}

#[cfg(test)]
#[path = "forces_tests.rs"]
mod tests;
