//! Statements but CASE and loops.

use cranelift_codegen::ir::{Block, InstBuilder, Value};

use super::lower::{LoopBlocks, Lower};
use super::place::Located;
use super::target::MEMORY;
use super::walk;
use crate::hir::{self, Expr, ExprKind, ForLoop, Intrinsic, Place, Statement, StatementKind};

impl Lower<'_> {
    pub(super) fn block(&mut self, block: &hir::Block) {
        for statement in block {
            self.statement(statement);
        }
    }

    fn statement(&mut self, statement: &Statement) {
        self.at(statement.location);
        match &statement.kind {
            StatementKind::Assign(place, value) => self.assign(place, value),
            StatementKind::Call(routine, arguments) => {
                let result = self.program.routine(*routine).result;
                match result.map(|id| {
                    self.program.types.scalar(self.program.routine(*routine).local(id).ty)
                }) {
                    Some(None) => {
                        self.call_into_temporary(*routine, arguments);
                    }
                    _ => {
                        self.call(*routine, arguments);
                    }
                }
            }
            StatementKind::Invoke(place, routine, arguments) => {
                self.invoke(place, *routine, arguments)
            }
            StatementKind::If(arms, otherwise) => self.branch(arms, otherwise),
            StatementKind::Case(selector, arms, otherwise) => self.case(selector, arms, otherwise),
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                self.count(statement.location, variable, [from, to, by], body);
            }
            StatementKind::While(condition, body) => {
                self.while_loop(statement.location, condition, body)
            }
            StatementKind::Repeat(body, until) => self.repeat_loop(statement.location, body, until),
            StatementKind::Exit => self.leave(|blocks| blocks.exit),
            StatementKind::Continue => self.leave(|blocks| {
                blocks.continued = true;
                blocks.next
            }),
            StatementKind::Return => {
                for (cell, variable) in self.written.clone() {
                    self.write_back(&cell, variable);
                }
                self.builder.ins().jump(self.return_block, &[]);
                self.unreachable_from_here();
            }
        }
    }

    fn leave(&mut self, to: impl FnOnce(&mut LoopBlocks) -> Block) {
        match self.loops.last_mut() {
            Some(blocks) => {
                let block = to(blocks);
                self.builder.ins().jump(block, &[]);
            }
            None => unreachable!("EXIT and CONTINUE are in loops"),
        }
        self.unreachable_from_here();
    }

    /// Goes on with a block that nothing jumps to, for the statements behind a jump.
    fn unreachable_from_here(&mut self) {
        let block = self.builder.create_block();
        self.builder.switch_to_block(block);
    }

    fn assign(&mut self, place: &Place, value: &Expr) {
        let types = &self.program.types;
        if types.is_string(place.ty) {
            let view =
                if walk::path_calls(place) { self.own_view(value) } else { self.view(value) };
            let Located::Memory(base, offset) = self.locate(place) else {
                unreachable!("a string is in memory")
            };
            self.assign_view(base, offset, place.ty, view);
            return;
        }
        if types.scalar(place.ty).is_some() {
            let value = self.in_register(value);
            let located = self.locate(place);
            self.store(located, value);
            return;
        }
        let size = types.size(place.ty);
        let mut from = self.aggregate(value);
        if walk::path_calls(place) {
            let copied = self.temporary(place.ty);
            self.copy(copied, from, size);
            from = copied;
        }
        let to = self.address(place);
        self.copy(to, from, size);
    }

    /// The address of a value that is a structure or an array.
    pub(super) fn aggregate(&mut self, expr: &Expr) -> Value {
        match &expr.kind {
            ExprKind::Load(place) => self.address(place),
            ExprKind::Call(routine, arguments) => self.call_into_temporary(*routine, arguments),
            ExprKind::Intrinsic(Intrinsic::Select, arguments) => {
                let choice = self.expr(&arguments[0]);
                let mut zero = self.aggregate(&arguments[1]);
                // What is called for the other one may change the variable.
                if walk::calls(&arguments[2]) {
                    let copied = self.temporary(expr.ty);
                    self.copy(copied, zero, self.program.types.size(expr.ty));
                    zero = copied;
                }
                let one = self.aggregate(&arguments[2]);
                self.builder.ins().select(choice, one, zero)
            }
            other => unreachable!("{other:?} is neither structure nor array"),
        }
    }

    fn branch(&mut self, arms: &[(Expr, hir::Block)], otherwise: &hir::Block) {
        let end = self.builder.create_block();
        for (condition, block) in arms {
            let condition = self.expr(condition);
            let (taken, next) = (self.builder.create_block(), self.builder.create_block());
            self.builder.ins().brif(condition, taken, &[], next, &[]);
            self.builder.switch_to_block(taken);
            self.block(block);
            self.builder.ins().jump(end, &[]);
            self.builder.switch_to_block(next);
        }
        self.block(otherwise);
        self.builder.ins().jump(end, &[]);
        self.builder.switch_to_block(end);
    }

    pub(super) fn write_back(
        &mut self,
        cell: &super::effects::Cell,
        variable: cranelift_frontend::Variable,
    ) {
        let value = self.builder.use_var(variable);
        let (base, offset) = self.cell_address(cell);
        self.builder.ins().store(MEMORY, value, base, offset);
    }
}
