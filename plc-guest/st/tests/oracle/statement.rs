//! Statements.

use takt_st::hir::{
    Block, Class, Expr, ForLoop, Location, Place, Statement, StatementKind, TrapKind,
};

use super::{Frame, Machine, Outcome, Value, trap};

/// How a statement ended.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    Next,
    Exit,
    Continue,
    Return,
}

impl Machine<'_> {
    pub(super) fn block(&mut self, frame: &Frame, block: &Block) -> Outcome<Flow> {
        for statement in block {
            let flow = self.statement(frame, statement)?;
            if flow != Flow::Next {
                return Ok(flow);
            }
        }
        Ok(Flow::Next)
    }

    fn statement(&mut self, frame: &Frame, statement: &Statement) -> Outcome<Flow> {
        self.spend()?;
        let location = statement.location;
        match &statement.kind {
            StatementKind::Assign(place, value) => {
                let value = self.expr(frame, value)?;
                let target = self.place(frame, place)?;
                self.store_target(&target, place.ty, &value);
                Ok(Flow::Next)
            }
            StatementKind::Call(routine, arguments) => {
                self.call_routine(Some(frame), *routine, 0, arguments)?;
                Ok(Flow::Next)
            }
            StatementKind::Invoke(place, routine, arguments) => {
                let target = self.place(frame, place)?;
                self.call_routine(Some(frame), *routine, target.address, arguments)?;
                Ok(Flow::Next)
            }
            StatementKind::If(arms, otherwise) => {
                for (condition, block) in arms {
                    if self.expr(frame, condition)?.is_true() {
                        return self.block(frame, block);
                    }
                }
                self.block(frame, otherwise)
            }
            StatementKind::Case(selector, arms, otherwise) => {
                let value = self.expr(frame, selector)?.integer();
                let holds = |&(low, high): &(i128, i128)| low <= value && value <= high;
                match arms.iter().find(|arm| arm.ranges.iter().any(holds)) {
                    Some(arm) => self.block(frame, &arm.body),
                    None => self.block(frame, otherwise),
                }
            }
            StatementKind::For(parts) => {
                let ForLoop { variable, from, to, by, body } = &**parts;
                self.count(frame, variable, [from, to, by], body, location)
            }
            StatementKind::While(condition, body) => self.rounds(1, location, |machine| {
                if !machine.expr(frame, condition)?.is_true() {
                    return Ok(Some(Flow::Next));
                }
                Ok(leaves(machine.block(frame, body)?))
            }),
            StatementKind::Repeat(body, until) => self.rounds(0, location, |machine| {
                if let Some(flow) = leaves(machine.block(frame, body)?) {
                    return Ok(Some(flow));
                }
                Ok(machine.expr(frame, until)?.is_true().then_some(Flow::Next))
            }),
            StatementKind::Exit => Ok(Flow::Exit),
            StatementKind::Continue => Ok(Flow::Continue),
            StatementKind::Return => Ok(Flow::Return),
        }
    }

    /// Rounds until `round` says how the loop ends. `more` are allowed than the budget is: a last test of the condition
    /// of a WHILE.
    fn rounds(
        &mut self,
        more: u32,
        location: Location,
        mut round: impl FnMut(&mut Self) -> Outcome<Option<Flow>>,
    ) -> Outcome<Flow> {
        let mut left = self.program.loop_budget + more;
        loop {
            if let Some(flow) = round(self)? {
                return Ok(flow);
            }
            left -= 1;
            if left == 0 {
                return trap(TrapKind::LoopBudget, location);
            }
            self.spend()?;
        }
    }

    fn count(
        &mut self,
        frame: &Frame,
        variable: &Place,
        [from, to, by]: [&Expr; 3],
        body: &Block,
        location: Location,
    ) -> Outcome<Flow> {
        let from = self.expr(frame, from)?;
        let to = self.expr(frame, to)?.integer();
        let by = self.expr(frame, by)?.integer();
        if by == 0 {
            return trap(TrapKind::LoopBudget, location);
        }
        let elementary = self.program.types.scalar(variable.ty).expect("a scalar");
        assert!(matches!(elementary.class(), Class::Signed | Class::Unsigned));
        let passed = |value: i128| if by > 0 { value > to } else { value < to };
        let target = self.place(frame, variable)?;
        self.store_target(&target, variable.ty, &from);
        if passed(from.integer()) {
            return Ok(Flow::Next);
        }
        self.rounds(0, location, |machine| {
            if let Some(flow) = leaves(machine.block(frame, body)?) {
                return Ok(Some(flow));
            }
            let now = machine.load_target(&target, variable.ty).integer();
            let next = now + by;
            machine.store_target(&target, variable.ty, &Value::Integer(elementary.wrap(next)));
            let ends = passed(now) || passed(next) || elementary.wrap(next) != next;
            Ok(ends.then_some(Flow::Next))
        })
    }
}

/// How a loop ends after a body that ended with `flow`, if it does.
fn leaves(flow: Flow) -> Option<Flow> {
    match flow {
        Flow::Next | Flow::Continue => None,
        Flow::Exit => Some(Flow::Next),
        Flow::Return => Some(Flow::Return),
    }
}
