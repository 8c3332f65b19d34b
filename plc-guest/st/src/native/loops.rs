//! Loops but FOR: the budget of rounds, and variables in registers.

use cranelift_codegen::ir::{InstBuilder, types};
use cranelift_frontend::Variable;

use super::effects::{Collector, Effects};
use super::lower::{LoopBlocks, Lower, Promoted};
use super::target::{MEMORY, register};
use super::trap::trap_code;
use crate::hir::{self, Expr, Location, TrapKind};

/// What must be undone behind a loop.
pub(super) struct Region {
    promoted: usize,
    written: usize,
}

impl Lower<'_> {
    pub(super) fn effects(&self, collect: impl FnOnce(&mut Collector<'_>)) -> Effects {
        let mut collector = Collector::new(self.program, self.routine, &self.knowledge.summaries);
        collect(&mut collector);
        collector.effects
    }

    /// Reads what can live in registers during a loop with these effects.
    pub(super) fn enter(&mut self, effects: &Effects) -> Region {
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
    pub(super) fn exit(&mut self, region: Region) {
        for (cell, variable) in self.written.split_off(region.written) {
            self.write_back(&cell, variable);
        }
        self.promoted.truncate(region.promoted);
    }

    /// A counter of the rounds that are left, and so many more.
    pub(super) fn budget(&mut self, more: i64) -> Variable {
        let rounds = i64::from(self.program.loop_budget) + more;
        let rounds = self.builder.ins().iconst(types::I32, rounds);
        self.new_variable(types::I32, rounds)
    }

    pub(super) fn spend(&mut self, budget: Variable, location: Location) {
        self.at(location);
        let left = self.builder.use_var(budget);
        let left = self.builder.ins().iadd_imm_s(left, -1);
        self.builder.def_var(budget, left);
        self.builder.ins().trapz(left, trap_code(TrapKind::LoopBudget));
    }

    pub(super) fn blocks(&mut self) -> LoopBlocks {
        let (next, exit) = (self.builder.create_block(), self.builder.create_block());
        LoopBlocks { next, exit, continued: false }
    }

    /// Goes on behind the body. That is a block of its own only if CONTINUE leads there: within one block Cranelift
    /// reads from memory where it computes.
    pub(super) fn body(&mut self, body: &hir::Block, blocks: LoopBlocks) {
        self.loops.push(blocks);
        self.block(body);
        let Some(LoopBlocks { next, continued, .. }) = self.loops.pop() else {
            unreachable!("pushed above")
        };
        if continued {
            self.builder.ins().jump(next, &[]);
            self.builder.switch_to_block(next);
        }
    }

    pub(super) fn while_loop(&mut self, location: Location, condition: &Expr, body: &hir::Block) {
        let effects = self.effects(|collector| {
            collector.expr(condition);
            collector.block(body);
        });
        let region = self.enter(&effects);
        let ranges = self.forget(&effects);
        // The last round is followed by a test of the condition, which is none.
        let budget = self.budget(1);
        let blocks = self.blocks();
        let (round, exit) = (self.builder.create_block(), blocks.exit);
        // The condition is in the text twice, before the first round and behind each: one jump less in a round.
        let first = self.expr(condition);
        self.builder.ins().brif(first, round, &[], exit, &[]);
        self.builder.switch_to_block(round);
        self.body(body, blocks);
        self.mark_loop(None, location);
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
        let budget = self.budget(0);
        let blocks = self.blocks();
        let (round, again, exit) =
            (self.builder.create_block(), self.builder.create_block(), blocks.exit);
        self.builder.ins().jump(round, &[]);
        self.builder.switch_to_block(round);
        self.body(body, blocks);
        let ends = self.expr(until);
        self.builder.ins().brif(ends, exit, &[], again, &[]);
        self.builder.switch_to_block(again);
        self.mark_loop(None, location);
        self.spend(budget, location);
        self.builder.ins().jump(round, &[]);
        self.builder.switch_to_block(exit);
        self.exit(region);
        self.ranges = ranges;
    }

    /// Forgets what was known of variables that a loop assigns. Returns what was known before.
    pub(super) fn forget(
        &mut self,
        effects: &Effects,
    ) -> std::collections::HashMap<super::effects::Cell, (i128, i128)> {
        let before = self.ranges.clone();
        self.ranges.retain(|cell, _| !effects.writes_to(cell));
        before
    }
}
