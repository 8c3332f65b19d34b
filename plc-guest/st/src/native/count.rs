//! FOR: how it counts, how it ends, and what is known of its variable meanwhile.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{InstBuilder, Value, types};
use cranelift_frontend::Variable;

use super::effects::{Cell, Collector, Effects, Target};
use super::lower::Lower;
use super::place::Located;
use super::target::register;
use crate::hir::{
    self, Class, Constant, Elementary, Expr, ExprKind, Location, Place, Statement, StatementKind,
    TrapKind,
};

/// The variable of a FOR that only the loop assigns, as a number of 64 bits. So an index needs no extension, and the
/// step past the end does not wrap: one comparison ends the loop.
pub(super) struct Counter {
    /// The variable, whose type is narrower than 64 bits.
    pub cell: Cell,
    /// Its value.
    pub value: Variable,
    /// Its value times the size of an element that no address has as a factor.
    pub scaled: Vec<(i64, Variable)>,
}

/// More products than this are not kept for a counter: each takes a register, and an addition in each round.
const SCALED: usize = 3;

impl Lower<'_> {
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
        let step = number(by);
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
        let exact = exact_end(first_range, last_range, step);
        let blocks = self.blocks();
        let (round, exit) = (self.builder.create_block(), blocks.exit);
        let budget = if bounded { None } else { Some(self.budget(0)) };
        let mut counter = None;
        if let (Target::Cell(cell), Some((low, high)), true) = (target, known, steady) {
            self.ranges.insert(cell, (low, high.max(low)));
            if ty.size() < 8 {
                let end = self.widen(last, ty, signed);
                counter = Some(end);
                self.open_counter(cell, first, body);
            }
        }
        self.builder.ins().brif(ends, exit, &[], round, &[]);
        self.builder.switch_to_block(round);
        if counter.is_some() {
            self.show_counter(located, ty);
        }
        self.body(body, blocks);
        self.at(location);
        let most =
            if bounded { rounds.and_then(|rounds| u64::try_from(rounds).ok()) } else { None };
        self.mark_loop(most, location);

        let leave = self.builder.create_block();
        // In a register the counter shows itself at the beginning of each round, and behind the last one.
        let hidden = counter.is_some() && matches!(located, Located::Register(_));
        let (ends, following) = if let (Some(end), Some(step)) = (counter, step) {
            let (next, ends) = self.advance_counter(step as i64, end);
            let narrow = if hidden && exact {
                // What `next` is behind the last round, without it: so that only one register counts.
                self.builder.ins().iadd(last, step_value)
            } else {
                self.builder.ins().ireduce(register(ty), next)
            };
            (ends, narrow)
        } else {
            let now = self.load(located, variable.ty);
            let next = self.builder.ins().iadd(now, step_value);
            let ends = if steady && exact {
                // Not `now` with `last`: so `now` ends here and `next` takes its register.
                let behind = self.builder.ins().iadd(last, step_value);
                self.builder.ins().icmp(IntCC::Equal, next, behind)
            } else {
                self.ends(ty, signed, step, step_value, now, last)
            };
            (ends, next)
        };
        if !hidden {
            self.store(located, following);
        }
        if let Some(budget) = budget {
            let again = self.builder.create_block();
            self.builder.ins().brif(ends, leave, &[], again, &[]);
            self.builder.switch_to_block(again);
            self.spend(budget, location);
            self.builder.ins().jump(round, &[]);
        } else {
            self.builder.ins().brif(ends, leave, &[], round, &[]);
        }
        self.builder.switch_to_block(leave);
        if hidden {
            self.store(located, following);
        }
        self.builder.ins().jump(exit, &[]);
        self.builder.switch_to_block(exit);
        self.exit(region);
        self.ranges = ranges;
    }

    /// Begins to count in 64 bits.
    fn open_counter(&mut self, cell: Cell, first: Value, body: &hir::Block) {
        let signed = cell.ty.class() == Class::Signed;
        let first = self.widen(first, cell.ty, signed);
        let value = self.new_variable(types::I64, first);
        self.counters.push(Counter { cell, value, scaled: Vec::new() });
        let mut scaled = Vec::new();
        for size in self.scales(body).into_iter().take(SCALED) {
            let product = self.builder.ins().imul_imm_s(first, size);
            scaled.push((size, self.new_variable(types::I64, product)));
        }
        if let Some(counter) = self.counters.last_mut() {
            counter.scaled = scaled;
        }
    }

    /// Gives the variable the counter's value, at the beginning of a round. What is in memory has it already.
    fn show_counter(&mut self, located: Located, ty: Elementary) {
        if let (Located::Register(_), Some(counter)) = (located, self.counters.last()) {
            let value = self.builder.use_var(counter.value);
            let value = self.builder.ins().ireduce(register(ty), value);
            self.store(located, value);
        }
    }

    /// Counts on behind the body. Returns the new value, and whether the end has been passed.
    fn advance_counter(&mut self, step: i64, end: Value) -> (Value, Value) {
        let Some(Counter { value, scaled, .. }) = self.counters.pop() else {
            unreachable!("opened before the body")
        };
        for (size, product) in scaled {
            let now = self.builder.use_var(product);
            let next = self.builder.ins().iadd_imm_s(now, size * step);
            self.builder.def_var(product, next);
        }
        let now = self.builder.use_var(value);
        let next = self.builder.ins().iadd_imm_s(now, step);
        self.builder.def_var(value, next);
        let passed = if step > 0 { IntCC::SignedGreaterThan } else { IntCC::SignedLessThan };
        (next, self.builder.ins().icmp(passed, next, end))
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
        Some(step) if step != 0 && first.0 == first.1 && last.0 == last.1 => {
            (last.0 - first.0) % step == 0
        }
        _ => false,
    }
}

pub(super) fn number(expr: &Expr) -> Option<i128> {
    match &expr.kind {
        ExprKind::Constant(Constant::Integer(value)) => Some(*value),
        _ => None,
    }
}
