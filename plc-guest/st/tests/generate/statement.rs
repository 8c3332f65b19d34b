//! Random statements.

use takt_st::hir::{
    Block, CaseArm, Constant, Elementary, Expr, ExprKind, ForLoop, Intrinsic, Local, LocalId,
    LocalKind, Place, Statement, StatementKind, Step, Type, TypeId,
};

use super::Generator;

impl Generator {
    pub fn block(&mut self, depth: u32) -> Block {
        let count = 1 + self.random.below(5);
        let mut block = Vec::new();
        for _ in 0..count {
            if self.size == 0 {
                break;
            }
            self.size -= 1;
            let location = self.here();
            if let Some(kind) = self.statement(depth) {
                block.push(Statement { kind, location });
            }
        }
        block
    }

    fn some_type(&mut self) -> TypeId {
        match self.random.below(12) {
            0 => self.program.types.string(9),
            1 => self.program.types.wstring(5),
            2 => {
                // A subrange, a reference: whatever scalar there is.
                let scalars: Vec<TypeId> = self
                    .program
                    .types
                    .iter()
                    .filter(|(_, ty)| matches!(ty, Type::Subrange { .. } | Type::Reference { .. }))
                    .map(|(id, _)| id)
                    .collect();
                *self.random.pick(&scalars)
            }
            3..=6 => {
                let common =
                    [Elementary::Dint, Elementary::Real, Elementary::Lreal, Elementary::Bool];
                let common = *self.random.pick(&common);
                self.elementary(common)
            }
            _ => {
                let any = *self.random.pick(&Elementary::ALL);
                self.elementary(any)
            }
        }
    }

    fn statement(&mut self, depth: u32) -> Option<StatementKind> {
        let choice = if depth == 0 { self.random.below(10) } else { self.random.below(20) };
        match choice {
            0 => self.copy(),
            1 => self.call(),
            2 if !self.instances.is_empty() => {
                let instances = self.instances.clone();
                let (place, block) = self.random.pick(&instances).clone();
                let arguments = self.arguments(&block, 2)?;
                let routine = block.id;
                let Type::Array { element, lower, upper } = *self.program.types.get(place.ty)
                else {
                    return Some(StatementKind::Invoke(place, routine, arguments));
                };
                let index = self.index(lower, upper);
                Some(StatementKind::Invoke(place.index(index, element), routine, arguments))
            }
            3 if self.loops > 0 && self.random.one_in(3) => {
                let leave = if self.random.one_in(2) {
                    StatementKind::Exit
                } else {
                    StatementKind::Continue
                };
                let location = self.here();
                let bool = self.elementary(Elementary::Bool);
                let condition = self.expr(bool, 2);
                Some(StatementKind::If(
                    vec![(condition, vec![Statement { kind: leave, location }])],
                    Vec::new(),
                ))
            }
            4 if self.random.one_in(6) => {
                let location = self.here();
                let bool = self.elementary(Elementary::Bool);
                let condition = self.expr(bool, 2);
                let leave = Statement { kind: StatementKind::Return, location };
                Some(StatementKind::If(vec![(condition, vec![leave])], Vec::new()))
            }
            5 => self.assign_part(),
            2..=4 | 6..=9 => {
                let ty = self.some_type();
                let writable = self.writable.clone();
                let place = self.place_of(&writable, ty)?;
                Some(StatementKind::Assign(place, self.expr(ty, 3)))
            }
            10 | 11 => {
                let bool = self.elementary(Elementary::Bool);
                let arms = (0..1 + self.random.below(3))
                    .map(|_| (self.expr(bool, 2), self.block(depth - 1)))
                    .collect();
                let otherwise =
                    if self.random.one_in(2) { self.block(depth - 1) } else { Vec::new() };
                Some(StatementKind::If(arms, otherwise))
            }
            12 | 13 => self.case(depth),
            14..=16 => self.count(depth),
            17 => {
                let bool = self.elementary(Elementary::Bool);
                let condition = self.expr(bool, 2);
                self.loops += 1;
                let body = self.block(depth - 1);
                self.loops -= 1;
                Some(StatementKind::While(condition, body))
            }
            _ => {
                let bool = self.elementary(Elementary::Bool);
                self.loops += 1;
                let body = self.block(depth - 1);
                self.loops -= 1;
                Some(StatementKind::Repeat(body, self.expr(bool, 2)))
            }
        }
    }

    /// A structure or an array as a whole.
    fn copy(&mut self) -> Option<StatementKind> {
        let wholes: Vec<TypeId> = self
            .program
            .types
            .iter()
            .filter(|(_, ty)| matches!(ty, Type::Structure(_) | Type::Array { .. }))
            .map(|(id, _)| id)
            .collect();
        let ty = *self.random.pick(&wholes);
        let (readable, writable) = (self.readable.clone(), self.writable.clone());
        let (from, to) = (self.place_of(&readable, ty)?, self.place_of(&writable, ty)?);
        let mut value = self.node(ty, ExprKind::Load(from));
        if self.random.one_in(4) {
            let other = self.place_of(&readable, ty)?;
            let other = self.node(ty, ExprKind::Load(other));
            let bool = self.elementary(Elementary::Bool);
            let arguments = vec![self.expr(bool, 2), value, other];
            value = self.node(ty, ExprKind::Intrinsic(Intrinsic::Select, arguments));
        }
        Some(StatementKind::Assign(to, value))
    }

    fn call(&mut self) -> Option<StatementKind> {
        if self.functions.is_empty() {
            return None;
        }
        let functions = self.functions.clone();
        let function = self.random.pick(&functions);
        let arguments = self.arguments(function, 2)?;
        Some(StatementKind::Call(function.id, arguments))
    }

    /// A bit or some bytes of a bit string, or an element of an open array.
    fn assign_part(&mut self) -> Option<StatementKind> {
        let writable = self.writable.clone();
        if !self.open.is_empty() && self.random.one_in(2) {
            let open = self.open.clone();
            let mut place = self.random.pick(&open).clone();
            let Type::OpenArray { element, .. } = *self.program.types.get(place.ty) else {
                return None;
            };
            let index = self.index(-3, 4);
            place.path.push(Step::OpenIndex(vec![index]));
            place.ty = element;
            return Some(StatementKind::Assign(place, self.expr(element, 2)));
        }
        let dword = self.elementary(Elementary::Dword);
        let mut place = self.place_of(&writable, dword)?;
        if self.random.one_in(2) {
            let bool = self.elementary(Elementary::Bool);
            place.path.push(Step::Bit(self.random.below(32) as u8));
            place.ty = bool;
            return Some(StatementKind::Assign(place, self.expr(bool, 2)));
        }
        let word = self.elementary(Elementary::Word);
        place.path.push(Step::Part { offset: 2 * self.random.below(2) as u32, ty: word });
        place.ty = word;
        Some(StatementKind::Assign(place, self.expr(word, 2)))
    }

    fn case(&mut self, depth: u32) -> Option<StatementKind> {
        let ty = *self.random.pick(&[
            Elementary::Sint,
            Elementary::Uint,
            Elementary::Dint,
            Elementary::Ulint,
        ]);
        let id = self.elementary(ty);
        let selector = self.expr(id, 2);
        let single = self.random.one_in(2);
        let arms = (0..1 + self.random.below(4)).map(|_| {
            let ranges = (0..1 + self.random.below(2)).map(|_| {
                let low = ty.wrap(self.random.below(40) as i128 - 10);
                let length = if single { 0 } else { self.random.below(9) as i128 };
                (low, (low + length).min(ty.range().expect("an integer").1))
            });
            let ranges = ranges.collect();
            CaseArm { ranges, body: self.block(depth - 1) }
        });
        let arms = arms.collect();
        let otherwise = self.block(depth - 1);
        Some(StatementKind::Case(selector, arms, otherwise))
    }

    fn count(&mut self, depth: u32) -> Option<StatementKind> {
        let ty = *self.random.pick(&[
            Elementary::Dint,
            Elementary::Dint,
            Elementary::Int,
            Elementary::Usint,
            Elementary::Sint,
            Elementary::Lint,
            Elementary::Ulint,
        ]);
        let id = self.elementary(ty);
        let variable = if self.random.one_in(2) {
            let index = self.locals.len() as u32;
            let name = format!("i{index}");
            self.locals.push(Local {
                name,
                ty: id,
                kind: LocalKind::Variable,
                initial: Constant::Default,
            });
            let place = Place::local(LocalId(index), id);
            self.readable.push(place.clone());
            place
        } else {
            // No index and no reference in its path.
            let plain: Vec<Place> =
                self.writable.iter().filter(|place| place.ty == id).cloned().collect();
            self.place_of(&plain, id)?
        };
        let constant = |generator: &mut Generator, value: i128| {
            let value = ExprKind::Constant(Constant::Integer(ty.wrap(value)));
            generator.node(id, value)
        };
        let (least, greatest) = ty.range().expect("an integer");
        let (from, to, by): (Expr, Expr, Expr) = match self.random.below(6) {
            0 => (constant(self, greatest - 3), constant(self, greatest), constant(self, 2)),
            1 => (constant(self, least + 4), constant(self, least), constant(self, -1)),
            2 => (self.expr(id, 1), self.expr(id, 1), self.expr(id, 1)),
            3 => {
                let low = self.random.below(5) as i128;
                let step = 1 + self.random.below(3) as i128;
                (constant(self, low), constant(self, low + 7), constant(self, step))
            }
            _ => {
                let low = self.random.below(5) as i128;
                let most = *self.random.pick(&[3, 12]);
                let high = low - 1 + self.random.below(most) as i128;
                (constant(self, low), constant(self, high), constant(self, 1))
            }
        };
        self.loops += 1;
        let open = self.counters.len();
        if let (
            ExprKind::Constant(Constant::Integer(from)),
            ExprKind::Constant(Constant::Integer(to)),
        ) = (&from.kind, &to.kind)
        {
            self.counters.push((variable.clone(), *from.min(to), *from.max(to)));
        }
        let body = self.block(depth - 1);
        self.counters.truncate(open);
        self.loops -= 1;
        Some(StatementKind::For(Box::new(ForLoop { variable, from, to, by, body })))
    }
}
