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
mod tests {
    use super::*;
    use takt_abi::live::{Area, Range};

    fn point(program: u8, offset: u32) -> Point {
        Point::new(Range { program, area: Area::State, offset, bytes: 4 }, None).unwrap()
    }

    fn values(forces: &Forces, program: u8) -> Vec<(u32, u64)> {
        forces.of(program).map(|(point, value)| (point.range.offset, value)).collect()
    }

    #[test]
    fn a_point_has_one_forced_value_until_it_is_released() {
        let mut forces = Forces::NONE;
        for (program, offset, value) in [(0, 0, 1), (1, 0, 2), (0, 4, 3), (0, 0, 4)] {
            forces.set(point(program, offset), value).unwrap();
        }
        assert_eq!((values(&forces, 0), values(&forces, 1)), (vec![(0, 4), (4, 3)], vec![(0, 2)]));
        assert_eq!(forces.count(), 3);
        forces.release(point(0, 0)).unwrap();
        assert_eq!(forces.release(point(0, 0)), Err(Refusal::NotForced));
        assert_eq!((values(&forces, 0), values(&forces, 1)), (vec![(4, 3)], vec![(0, 2)]));
        assert!(forces.any(1) && !forces.any(2) && !forces.any(16));
        forces.clear();
        assert!(!forces.any(1));
        assert!(values(&forces, 0).is_empty() && forces.count() == 0);
    }

    #[test]
    fn one_more_than_there_is_room_for_is_refused_and_changes_nothing() {
        let mut forces = Forces::NONE;
        for offset in 0..FORCES as u32 {
            forces.set(point(0, offset), 1).unwrap();
        }
        assert_eq!(forces.set(point(0, 1 << 20), 1), Err(Refusal::Full));
        assert_eq!(forces.set(point(16, 0), 1), Err(Refusal::NoProgram));
        assert_eq!(values(&forces, 0).len(), FORCES);
        forces.set(point(0, 7), 2).unwrap();
        forces.release(point(0, 0)).unwrap();
        forces.set(point(0, 1 << 20), 1).unwrap();
    }
}
