//! Loops: the budget of rounds, and variables in registers.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{InstBuilder, Value, types};
use cranelift_frontend::Variable;

use super::effects::{Collector, Effects, Target};
use super::lower::{LoopBlocks, Lower, Promoted};
use super::target::{MEMORY, register};
use super::trap::trap_code;
use crate::hir::{
    self, Class, Constant, Elementary, Expr, ExprKind, Location, Place, Statement, StatementKind,
    TrapKind,
};

/// What must be undone behind a loop.
struct Region {
    promoted: usize,
    written: usize,
}

impl Lower<'_> {
    fn effects(&self, collect: impl FnOnce(&mut Collector<'_>)) -> Effects {
        let mut collector = Collector::new(self.program, self.routine, &self.knowledge.summaries);
        collect(&mut collector);
        collector.effects
    }

    /// Reads what can live in registers during a loop with these effects.
    fn enter(&mut self, effects: &Effects) -> Region {
        let region = Region { promoted: self.promoted.len(), written: self.written.len() };
        for (cell, written) in self.knowledge.promotable(self.routine, effects) {
            if self.register_of(&cell).is_some() {
                continue;
            }
            let (base, offset) = self.cell_address(&cell);
            let value = self.builder.ins().load(register(cell.ty), MEMORY, base, offset);
            let variable = self.new_variable(register(cell.ty), value);
            self.promoted.push(Promoted { cell, variable });
            if written {
                self.written.push((cell, variable));
            }
        }
        region
    }

    /// Writes back what the loop assigned.
    fn exit(&mut self, region: Region) {
        for (cell, variable) in self.written.split_off(region.written) {
            self.write_back(&cell, variable);
        }
        self.promoted.truncate(region.promoted);
    }

    /// A counter of the rounds that are left.
    fn budget(&mut self) -> Variable {
        let rounds = self.builder.ins().iconst(types::I32, i64::from(self.program.loop_budget));
        self.new_variable(types::I32, rounds)
    }

    fn spend(&mut self, budget: Variable, location: Location) {
        self.at(location);
        let left = self.builder.use_var(budget);
        let left = self.builder.ins().iadd_imm_s(left, -1);
        self.builder.def_var(budget, left);
        self.builder.ins().trapz(left, trap_code(TrapKind::LoopBudget));
    }

    fn blocks(&mut self) -> LoopBlocks {
        LoopBlocks { next: self.builder.create_block(), exit: self.builder.create_block() }
    }

    fn body(&mut self, body: &hir::Block, blocks: LoopBlocks) -> LoopBlocks {
        let next = blocks.next;
        self.loops.push(blocks);
        self.block(body);
        self.builder.ins().jump(next, &[]);
        self.builder.switch_to_block(next);
        self.loops.pop().unwrap_or_else(|| unreachable!("pushed above"))
    }

    pub(super) fn while_loop(&mut self, location: Location, condition: &Expr, body: &hir::Block) {
        let effects = self.effects(|collector| {
            collector.expr(condition);
            collector.block(body);
        });
        let region = self.enter(&effects);
        let ranges = self.forget(&effects);
        let budget = self.budget();
        let blocks = self.blocks();
        let (round, exit) = (self.builder.create_block(), blocks.exit);
        // The condition is in the text twice, before the first round and behind each: one jump less in a round.
        let first = self.expr(condition);
        self.builder.ins().brif(first, round, &[], exit, &[]);
        self.builder.switch_to_block(round);
        self.body(body, blocks);
        self.spend(budget, location);
        let again = self.expr(condition);
        self.builder.ins().brif(again, round, &[], exit, &[]);
        self.builder.switch_to_block(exit);
        self.exit(region);
        self.ranges = ranges;
    }

    pub(super) fn repeat_loop(&mut self, location: Location, body: &hir::Block, until: &Expr) {
        let effects = self.effects(|collector| {
            collector.expr(until);
            collector.block(body);
        });
        let region = self.enter(&effects);
        let ranges = self.forget(&effects);
        let budget = self.budget();
        let blocks = self.blocks();
        let (round, again, exit) =
            (self.builder.create_block(), self.builder.create_block(), blocks.exit);
        self.builder.ins().jump(round, &[]);
        self.builder.switch_to_block(round);
        self.body(body, blocks);
        let ends = self.expr(until);
        self.builder.ins().brif(ends, exit, &[], again, &[]);
        self.builder.switch_to_block(again);
        self.spend(budget, location);
        self.builder.ins().jump(round, &[]);
        self.builder.switch_to_block(exit);
        self.exit(region);
        self.ranges = ranges;
    }

    pub(super) fn count(
        &mut self,
        location: Location,
        variable: &Place,
        [from, to, by]: [&Expr; 3],
        body: &hir::Block,
    ) {
        let ty = self.scalar(variable.ty);
        let signed = ty.class() == Class::Signed;
        let (first_range, last_range, step_range) =
            (self.range(from), self.range(to), self.range(by));
        let step = constant(by);
        let first = self.expr(from);
        let last = self.expr(to);
        let step_value = self.expr(by);
        if step_range.0 <= 0 && step_range.1 >= 0 {
            let zero = self.builder.ins().icmp_imm_s(IntCC::Equal, step_value, 0);
            self.trap_if(zero, TrapKind::LoopBudget, location);
        }

        let mut effects = self.effects(|collector| collector.block(body));
        let target = self.target(variable);
        let steady = match target {
            Target::Cell(cell) => !effects.writes_to(&cell) && self.is_alone(&effects, variable),
            _ => false,
        };
        // The count itself reads and writes the variable.
        let counting = Statement {
            kind: StatementKind::Assign(
                variable.clone(),
                Expr::new(variable.ty, ExprKind::Load(variable.clone()), location),
            ),
            location,
        };
        effects = {
            let mut collector =
                Collector::new(self.program, self.routine, &self.knowledge.summaries);
            collector.effects = effects;
            collector.statement(&counting);
            collector.effects
        };
        let region = self.enter(&effects);
        let ranges = self.forget(&effects);
        let known = match step {
            Some(step) if step > 0 => Some((first_range.0, last_range.1)),
            Some(step) if step < 0 => Some((last_range.0, first_range.1)),
            _ => None,
        };
        let rounds =
            known.zip(step).map(|((low, high), step)| (high - low).max(0) / step.abs() + 1);
        let bounded =
            steady && rounds.is_some_and(|rounds| rounds <= i128::from(self.program.loop_budget));

        let located = self.locate(variable);
        self.store(located, first);
        let ends = self.passed(ty, step, step_value, first, last);
        let blocks = self.blocks();
        let (round, exit) = (self.builder.create_block(), blocks.exit);
        let budget = if bounded { None } else { Some(self.budget()) };
        self.builder.ins().brif(ends, exit, &[], round, &[]);
        self.builder.switch_to_block(round);
        if let (Target::Cell(cell), Some((low, high)), true) = (target, known, steady) {
            self.ranges.insert(cell, (low, high.max(low)));
        }
        self.body(body, blocks);
        self.at(location);

        let located = self.locate(variable);
        let now = self.load(located, variable.ty);
        let next = self.builder.ins().iadd(now, step_value);
        self.store(located, next);
        let ends = if steady && exact_end(first_range, last_range, step) {
            self.builder.ins().icmp(IntCC::Equal, now, last)
        } else {
            self.ends(ty, signed, step, step_value, now, last)
        };
        if let Some(budget) = budget {
            let again = self.builder.create_block();
            self.builder.ins().brif(ends, exit, &[], again, &[]);
            self.builder.switch_to_block(again);
            self.spend(budget, location);
            self.builder.ins().jump(round, &[]);
        } else {
            self.builder.ins().brif(ends, exit, &[], round, &[]);
        }
        self.builder.switch_to_block(exit);
        self.exit(region);
        self.ranges = ranges;
    }

    /// Whether nothing in a loop with these effects can change the variable but an assignment that names it.
    fn is_alone(&self, effects: &Effects, variable: &Place) -> bool {
        let Target::Cell(cell) = self.target(variable) else { return false };
        self.register_of(&cell).is_some() || {
            let mut with = effects.clone();
            with.accesses.entry(Target::Cell(cell)).or_default().total += u32::MAX / 2;
            self.knowledge.promotable(self.routine, &with).iter().any(|(found, _)| *found == cell)
        }
    }

    /// Forgets what was known of variables that a loop assigns. Returns what was known before.
    fn forget(
        &mut self,
        effects: &Effects,
    ) -> std::collections::HashMap<super::effects::Cell, (i128, i128)> {
        let before = self.ranges.clone();
        self.ranges.retain(|cell, _| !effects.writes_to(cell));
        before
    }

    /// Whether the variable has passed the end.
    fn passed(
        &mut self,
        ty: Elementary,
        step: Option<i128>,
        by: Value,
        now: Value,
        last: Value,
    ) -> Value {
        let signed = ty.class() == Class::Signed;
        let (greater, less) = if signed {
            (IntCC::SignedGreaterThan, IntCC::SignedLessThan)
        } else {
            (IntCC::UnsignedGreaterThan, IntCC::UnsignedLessThan)
        };
        match step {
            Some(step) if step < 0 => self.builder.ins().icmp(less, now, last),
            Some(_) => self.builder.ins().icmp(greater, now, last),
            None if !signed => self.builder.ins().icmp(greater, now, last),
            None => {
                let down = self.builder.ins().icmp_imm_s(IntCC::SignedLessThan, by, 0);
                let below = self.builder.ins().icmp(less, now, last);
                let above = self.builder.ins().icmp(greater, now, last);
                self.builder.ins().select(down, below, above)
            }
        }
    }

    /// Whether the round that began with `now` was the last: the end has been passed, or the step passes it. The second
    /// is that the distance to the end is less than the step, which is computed without overflow.
    fn ends(
        &mut self,
        ty: Elementary,
        signed: bool,
        step: Option<i128>,
        by: Value,
        now: Value,
        last: Value,
    ) -> Value {
        let (less, less_or_equal) = if signed {
            (IntCC::SignedLessThan, IntCC::SignedLessThanOrEqual)
        } else {
            (IntCC::UnsignedLessThan, IntCC::UnsignedLessThanOrEqual)
        };
        // A step of one: the distance is less than it where the end is reached.
        match step {
            Some(1) => return self.builder.ins().icmp(less_or_equal, last, now),
            Some(-1) => return self.builder.ins().icmp(less_or_equal, now, last),
            _ => {}
        }
        let passed = self.passed(ty, step, by, now, last);
        let up = self.builder.ins().isub(last, now);
        let down = self.builder.ins().isub(now, last);
        let back = self.builder.ins().ineg(by);
        let near_up = self.builder.ins().icmp(IntCC::UnsignedLessThan, up, by);
        let near_down = self.builder.ins().icmp(IntCC::UnsignedLessThan, down, back);
        let near = match step {
            Some(step) if step < 0 => near_down,
            Some(_) => near_up,
            None if !signed => near_up,
            None => {
                let negative = self.builder.ins().icmp_imm_s(less, by, 0);
                self.builder.ins().select(negative, near_down, near_up)
            }
        };
        self.builder.ins().bor(passed, near)
    }
}

/// Whether the variable takes the end value exactly, if only the loop counts it.
fn exact_end(first: (i128, i128), last: (i128, i128), step: Option<i128>) -> bool {
    match step {
        Some(1 | -1) => true,
        Some(step) if first.0 == first.1 && last.0 == last.1 => (last.0 - first.0) % step == 0,
        _ => false,
    }
}

fn constant(expr: &Expr) -> Option<i128> {
    match &expr.kind {
        ExprKind::Constant(Constant::Integer(value)) => Some(*value),
        _ => None,
    }
}
