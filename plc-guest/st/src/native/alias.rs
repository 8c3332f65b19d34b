//! Which variables may live in registers during a loop.

use std::collections::BTreeMap;

use super::effects::{Base, Cell, Collector, Effects, Target, instances};
use crate::hir::{Area, Elementary, Program, Routine, RoutineId, StatementKind, TypeId};

/// More variables than this are not kept in registers during one loop: there are fewer registers.
const PROMOTED: usize = 24;

/// What is known of a whole program before a routine is compiled.
pub struct Knowledge {
    /// What each routine does, as its callers see it.
    pub summaries: Vec<Effects>,
    /// Where instances lie in the state.
    instances: BTreeMap<TypeId, Vec<(u32, u32)>>,
    /// Stretches that more than one task uses. A register must not hide a write of another task, nor write back what
    /// that task has changed since.
    shared: Vec<(Area, u32, u32)>,
    /// How many tasks there are, without that of the tests.
    tasks: usize,
}

impl Knowledge {
    /// Looks at all routines, callees first.
    pub fn of(program: &Program) -> Knowledge {
        let mut summaries = vec![Effects::default(); program.routines.len()];
        for id in callees_first(program) {
            let routine = program.routine(id);
            let mut collector = Collector::new(program, routine, &summaries);
            collector.block(&routine.body);
            let summary = collector.effects.summary();
            summaries[id.0 as usize] = summary;
        }
        let mut shared = Vec::new();
        let of_task = |index: usize| &summaries[program.tasks[index].entry.0 as usize];
        // The task of tests is the last. It runs between the jobs of the others only, and its program must be the one
        // that is tested.
        let tasks = program.tasks.len() - usize::from(program.tests.wanted.is_some());
        for first in 0..tasks {
            for second in first + 1..tasks {
                overlaps(of_task(first), of_task(second), &mut shared);
            }
        }
        shared.sort_unstable();
        shared.dedup();
        Knowledge { summaries, instances: instances(program), shared, tasks }
    }

    /// The cells that `effects`, of a loop of `routine`, let live in registers.
    pub fn promotable(&self, routine: &Routine, effects: &Effects) -> Vec<(Cell, bool)> {
        let mut cells: Vec<(Cell, u32, bool)> = Vec::new();
        for (target, uses) in &effects.accesses {
            if let Target::Cell(cell) = target
                && !self.is_shared(routine, target)
            {
                cells.push((*cell, uses.total, uses.writes > 0));
            }
        }
        cells.sort_by_key(|(cell, total, _)| (std::cmp::Reverse(*total), *cell));
        // Each is compared with all accesses: so the first ones only, and not all of thousands.
        let cells = cells.into_iter().map(|(cell, _, written)| (cell, written));
        let alone = |(cell, written): &(Cell, bool)| !self.hidden(routine, effects, cell, *written);
        cells.filter(alone).take(PROMOTED).collect()
    }

    /// Whether another task may use what an access of a routine touches.
    pub fn is_shared(&self, routine: &Routine, target: &Target) -> bool {
        let (base, start, end) = match *target {
            Target::Cell(Cell { base, offset, ty }) => (base, offset, offset + ty.size()),
            Target::Range { base, start, end, .. } => (base, start, end),
            Target::Indirect(_) => return self.tasks > 1,
        };
        let shared = |area: Area, start: u32, end: u32| {
            self.shared
                .iter()
                .any(|(other, low, high)| *other == area && start < *high && *low < end)
        };
        match base {
            Base::Local(_) => false,
            _ if self.tasks < 2 => false,
            Base::Pointer(_) => true,
            Base::Area(area) => shared(area, start, end),
            Base::Instance => self
                .instances_of(routine)
                .iter()
                .any(|(low, high)| shared(Area::State, *low, *high)),
        }
    }

    fn instances_of(&self, routine: &Routine) -> &[(u32, u32)] {
        routine.instance.and_then(|ty| self.instances.get(&ty)).map_or(&[], Vec::as_slice)
    }

    /// Whether some access may touch the cell's memory in another way than as this cell.
    fn hidden(&self, routine: &Routine, effects: &Effects, cell: &Cell, written: bool) -> bool {
        effects.accesses.iter().any(|(target, uses)| {
            (written || uses.writes > 0)
                && *target != Target::Cell(*cell)
                && self.may_meet(routine, cell, target)
        })
    }

    fn may_meet(&self, routine: &Routine, cell: &Cell, target: &Target) -> bool {
        let (base, start, end, ty) = match *target {
            Target::Cell(other) => {
                (other.base, other.offset, other.offset + other.ty.size(), Some(other.ty))
            }
            Target::Range { base, start, end, ty } => (base, start, end, ty),
            Target::Indirect(ty) => {
                return may_refer(cell, ty);
            }
        };
        let overlap = cell.offset < end && start < cell.offset + cell.ty.size();
        match (cell.base, base) {
            (mine, other) if mine == other => overlap,
            (Base::Area(_), Base::Area(_)) | (Base::Local(_), _) | (_, Base::Local(_)) => false,
            (Base::Instance, Base::Area(Area::State)) => {
                self.instances_of(routine).iter().any(|(low, high)| start < *high && *low < end)
            }
            (Base::Area(Area::State), Base::Instance) => {
                let end = cell.offset + cell.ty.size();
                self.instances_of(routine)
                    .iter()
                    .any(|(low, high)| cell.offset < *high && *low < end)
            }
            (Base::Instance, Base::Area(_)) | (Base::Area(_), Base::Instance) => false,
            // What lies in the state has one type.
            (Base::Pointer(_), Base::Area(Area::State) | Base::Instance) => {
                ty.is_none_or(|ty| ty == cell.ty)
            }
            _ => may_refer(cell, ty),
        }
    }
}

/// Whether a reference to type `ty`, or a parameter or an address of it, may stand for the cell. What lies in %I, %Q and
/// %M may have several types, and a parameter may stand for such a place.
fn may_refer(cell: &Cell, ty: Option<Elementary>) -> bool {
    match cell.base {
        Base::Area(Area::Input | Area::Output | Area::Marker) | Base::Pointer(_) => true,
        _ => ty.is_none_or(|ty| ty == cell.ty),
    }
}

fn overlaps(first: &Effects, second: &Effects, shared: &mut Vec<(Area, u32, u32)>) {
    let others = stretches(second);
    for (area, start, end, write) in stretches(first) {
        for &(other, low, high, writes) in &others {
            if area == other && (write || writes) && start < high && low < end {
                shared.push((area, start.max(low), end.min(high)));
            }
        }
    }
}

/// What a task touches: areas with the first byte, the byte behind the last, and whether it writes there.
fn stretches(effects: &Effects) -> Vec<(Area, u32, u32, bool)> {
    const ALL: [Area; 4] = [Area::State, Area::Input, Area::Output, Area::Marker];
    let mut found = Vec::new();
    for (target, uses) in &effects.accesses {
        let write = uses.writes > 0;
        match *target {
            Target::Range { base: Base::Area(area), start, end, .. } => {
                found.push((area, start, end, write));
            }
            // A reference may refer to a variable with an address, too.
            Target::Indirect(_) => {
                found.extend(ALL.map(|area| (area, 0, u32::MAX, write)));
            }
            _ => {}
        }
    }
    found
}

/// All routines, each behind those that it calls. Calls form no cycle.
pub fn callees_first(program: &Program) -> Vec<RoutineId> {
    let mut order = Vec::new();
    let mut seen = vec![false; program.routines.len()];
    for start in 0..program.routines.len() {
        // A stack of its own: the depth of calls is the user's.
        let mut stack = vec![(RoutineId(start as u32), false)];
        while let Some((id, done)) = stack.pop() {
            if done {
                order.push(id);
            } else if !std::mem::replace(&mut seen[id.0 as usize], true) {
                stack.push((id, true));
                stack.extend(called(program, id).into_iter().map(|callee| (callee, false)));
            }
        }
    }
    order
}

/// The routines that a routine calls, each once, in the order of the text.
pub fn called(program: &Program, id: RoutineId) -> Vec<RoutineId> {
    let mut found = Vec::new();
    super::walk::statements(&program.routine(id).body, &mut |statement| {
        if let StatementKind::Call(routine, _) | StatementKind::Invoke(_, routine, _) =
            &statement.kind
        {
            found.push(*routine);
        }
    });
    super::walk::expressions(&program.routine(id).body, &mut |expr| {
        if let crate::hir::ExprKind::Call(routine, _) = &expr.kind {
            found.push(*routine);
        }
    });
    found.sort_unstable();
    found.dedup();
    found
}

#[cfg(test)]
#[path = "alias_tests.rs"]
mod tests;
