//! Random expressions.

use takt_st::hir::{
    Argument, Arithmetic, Class, Comparison, Constant, Conversion, Elementary, Expr, ExprKind,
    Intrinsic, LocalKind, Place, Step, Type, TypeId, UnaryOperator,
};

use super::{Callable, Generator};

pub const NUMBERS: [Elementary; 10] = [
    Elementary::Sint,
    Elementary::Int,
    Elementary::Dint,
    Elementary::Lint,
    Elementary::Usint,
    Elementary::Uint,
    Elementary::Udint,
    Elementary::Ulint,
    Elementary::Real,
    Elementary::Lreal,
];

impl Generator {
    pub fn constant(&mut self, ty: TypeId) -> Expr {
        let value = match self.program.types.get(ty).clone() {
            Type::String { capacity } => Constant::String(
                (0..self.random.below(usize::from(capacity) + 1))
                    .map(|_| b'a' + self.random.below(4) as u8)
                    .collect(),
            ),
            Type::WString { capacity } => Constant::WString(
                (0..self.random.below(usize::from(capacity) + 1))
                    .map(|_| 0x3b1 + self.random.below(4) as u16)
                    .collect(),
            ),
            Type::Subrange { lower, upper, .. } => Constant::Integer(
                lower + (self.random.next() as i128).rem_euclid(upper - lower + 1),
            ),
            Type::Reference { .. } => Constant::Default,
            _ => self.scalar_constant(self.program.types.scalar(ty).expect("a scalar")),
        };
        self.node(ty, ExprKind::Constant(value))
    }

    fn scalar_constant(&mut self, ty: Elementary) -> Constant {
        match ty.range() {
            None => {
                const VALUES: [f64; 12] = [
                    0.0,
                    -0.0,
                    1.0,
                    -1.5,
                    2.5,
                    3.5,
                    1e10,
                    -7e-5,
                    1e300,
                    f64::INFINITY,
                    100.25,
                    -32768.5,
                ];
                let value = *self.random.pick(&VALUES);
                Constant::Real(if ty == Elementary::Real { f64::from(value as f32) } else { value })
            }
            Some((least, greatest)) => Constant::Integer(match self.random.below(6) {
                0 => least,
                1 => greatest,
                2 | 3 => ty.wrap(self.random.below(20) as i128 - 8),
                _ => ty.wrap(i128::from(self.random.next() as i64)),
            }),
        }
    }

    pub fn boxed(&mut self, ty: TypeId, depth: u32) -> Box<Expr> {
        Box::new(self.expr(ty, depth))
    }

    /// An expression of this scalar or string type.
    pub fn expr(&mut self, ty: TypeId, depth: u32) -> Expr {
        if depth == 0 || self.random.one_in(4) {
            let readable = self.readable.clone();
            return match self.place_of(&readable, ty) {
                Some(place) if !self.random.one_in(4) => self.node(ty, ExprKind::Load(place)),
                _ => self.constant(ty),
            };
        }
        if self.random.one_in(8)
            && let Some(call) = self.call_with_result(ty, depth - 1)
        {
            return call;
        }
        match self.program.types.get(ty).clone() {
            Type::Subrange { base, lower, upper, .. } => {
                // Mostly within the range.
                let base_id = self.elementary(base);
                let operand = if self.random.one_in(10) {
                    self.expr(base_id, depth - 1)
                } else {
                    let value = lower + (self.random.next() as i128).rem_euclid(upper - lower + 1);
                    self.node(base_id, ExprKind::Constant(Constant::Integer(value)))
                };
                self.node(ty, ExprKind::Convert(Conversion::Check, Box::new(operand)))
            }
            Type::String { .. } => self.text(ty, depth - 1, false),
            Type::WString { .. } => self.text(ty, depth - 1, true),
            Type::Reference { .. } => {
                let Type::Reference { target } = *self.program.types.get(ty) else {
                    unreachable!()
                };
                let globals: Vec<Place> = self
                    .readable
                    .iter()
                    .filter(|p| matches!(p.root, takt_st::hir::Root::Global(_)))
                    .cloned()
                    .collect();
                match self.place_of(&globals, target) {
                    Some(place) if self.is_addressable(&place) => {
                        self.node(ty, ExprKind::Reference(place))
                    }
                    _ => self.constant(ty),
                }
            }
            _ => self.scalar(ty, depth - 1),
        }
    }

    /// Not a bit, and nothing that is reached through a reference: what a NULL in it is, is another test.
    pub fn is_addressable(&self, place: &Place) -> bool {
        let bit = match &place.root {
            takt_st::hir::Root::Global(id) => self.program.global(*id).storage.bit.is_some(),
            _ => false,
        };
        !bit && !place
            .path
            .iter()
            .any(|step| matches!(step, Step::Bit(_) | Step::Part { .. } | Step::Unit(_)))
    }

    fn scalar(&mut self, ty: TypeId, depth: u32) -> Expr {
        let elementary = self.program.types.scalar(ty).expect("a scalar");
        let is_plain = matches!(self.program.types.get(ty), Type::Elementary(_));
        let kind = match elementary.class() {
            _ if !is_plain => return self.constant(ty),
            Class::Bool => self.boolean(ty, depth),
            Class::Float => self.real(ty, elementary, depth),
            Class::Signed | Class::Unsigned => self.integer(ty, elementary, depth),
        };
        self.node(ty, kind)
    }

    fn boolean(&mut self, ty: TypeId, depth: u32) -> ExprKind {
        const COMPARISONS: [Comparison; 6] = [
            Comparison::Equal,
            Comparison::NotEqual,
            Comparison::Less,
            Comparison::LessEqual,
            Comparison::Greater,
            Comparison::GreaterEqual,
        ];
        match self.random.below(8) {
            0 => ExprKind::AndThen(self.boxed(ty, depth), self.boxed(ty, depth)),
            1 => ExprKind::OrElse(self.boxed(ty, depth), self.boxed(ty, depth)),
            2 => ExprKind::Unary(UnaryOperator::Not, self.boxed(ty, depth)),
            3 => {
                let operator =
                    *self.random.pick(&[Arithmetic::And, Arithmetic::Or, Arithmetic::Xor]);
                ExprKind::Arithmetic(operator, self.boxed(ty, depth), self.boxed(ty, depth))
            }
            4 => {
                let text = if self.random.one_in(2) {
                    self.program.types.string(9)
                } else {
                    self.program.types.wstring(5)
                };
                let comparison = *self.random.pick(&COMPARISONS);
                ExprKind::Compare(comparison, self.boxed(text, depth), self.boxed(text, depth))
            }
            5 => {
                let from = *self.random.pick(&NUMBERS);
                let from = self.elementary(from);
                ExprKind::Convert(Conversion::Value, self.boxed(from, depth))
            }
            _ => {
                let operands = *self.random.pick(&Elementary::ALL);
                let operands = self.elementary(operands);
                let comparison = *self.random.pick(&COMPARISONS);
                ExprKind::Compare(
                    comparison,
                    self.boxed(operands, depth),
                    self.boxed(operands, depth),
                )
            }
        }
    }

    fn real(&mut self, ty: TypeId, elementary: Elementary, depth: u32) -> ExprKind {
        match self.random.below(10) {
            0 => ExprKind::Unary(UnaryOperator::Negate, self.boxed(ty, depth)),
            1 => {
                let from = *self.random.pick(&Elementary::ALL);
                if from.class() == Class::Bool {
                    return ExprKind::Constant(self.scalar_constant(elementary));
                }
                let from = self.elementary(from);
                ExprKind::Convert(Conversion::Value, self.boxed(from, depth))
            }
            2 => {
                use Intrinsic::*;
                let one =
                    *self.random.pick(&[Abs, Sqrt, Ln, Log, Exp, Sin, Cos, Tan, Asin, Acos, Atan]);
                ExprKind::Intrinsic(one, vec![self.expr(ty, depth)])
            }
            3 => {
                use Intrinsic::*;
                let of = *self.random.pick(&[Atan2, Power, Min, Max, Limit]);
                let count = if of == Limit { 3 } else { 2 };
                ExprKind::Intrinsic(of, (0..count).map(|_| self.expr(ty, depth)).collect())
            }
            4 => self.select(ty, depth),
            _ => {
                let operators = [
                    Arithmetic::Add,
                    Arithmetic::Subtract,
                    Arithmetic::Multiply,
                    Arithmetic::Divide,
                ];
                let operator = *self.random.pick(&operators);
                ExprKind::Arithmetic(operator, self.boxed(ty, depth), self.boxed(ty, depth))
            }
        }
    }

    fn select(&mut self, ty: TypeId, depth: u32) -> ExprKind {
        let bool = self.elementary(Elementary::Bool);
        let arguments = vec![self.expr(bool, depth), self.expr(ty, depth), self.expr(ty, depth)];
        ExprKind::Intrinsic(Intrinsic::Select, arguments)
    }

    fn integer(&mut self, ty: TypeId, elementary: Elementary, depth: u32) -> ExprKind {
        let lint = self.elementary(Elementary::Lint);
        match self.random.below(14) {
            0 => ExprKind::Unary(
                if elementary.class() == Class::Signed {
                    UnaryOperator::Negate
                } else {
                    UnaryOperator::Not
                },
                self.boxed(ty, depth),
            ),
            1 | 2 => {
                let from = *self.random.pick(&Elementary::ALL);
                let conversion = if from.class() == Class::Float && self.random.one_in(2) {
                    Conversion::Truncate
                } else {
                    Conversion::Value
                };
                let from = self.elementary(from);
                ExprKind::Convert(conversion, self.boxed(from, depth))
            }
            3 => {
                use Intrinsic::*;
                let shift = *self.random.pick(&[ShiftLeft, ShiftRight, RotateLeft, RotateRight]);
                let count = if self.random.one_in(3) {
                    self.expr(lint, depth)
                } else {
                    let count = Constant::Integer(self.random.below(70) as i128 - 2);
                    self.node(lint, ExprKind::Constant(count))
                };
                ExprKind::Intrinsic(shift, vec![self.expr(ty, depth), count])
            }
            4 => {
                let two = *self.random.pick(&[Intrinsic::Min, Intrinsic::Max]);
                ExprKind::Intrinsic(two, vec![self.expr(ty, depth), self.expr(ty, depth)])
            }
            5 => self.select(ty, depth),
            6 if ty == lint => {
                let text = self.program.types.string(9);
                match self.random.below(2) {
                    0 => ExprKind::Intrinsic(Intrinsic::Length, vec![self.expr(text, depth)]),
                    _ => ExprKind::Intrinsic(
                        Intrinsic::Find,
                        vec![self.expr(text, depth), self.expr(text, depth)],
                    ),
                }
            }
            6 if elementary == Elementary::Byte => {
                let text = self.program.types.string(9);
                ExprKind::Intrinsic(
                    Intrinsic::UnitAt,
                    vec![self.expr(text, depth), self.expr(lint, depth)],
                )
            }
            6 if elementary == Elementary::Ulint => {
                ExprKind::Intrinsic(Intrinsic::Cycle, Vec::new())
            }
            6 if elementary == Elementary::Time => ExprKind::Intrinsic(
                *self.random.pick(&[Intrinsic::Now, Intrinsic::Elapsed]),
                Vec::new(),
            ),
            7 | 8 => {
                let operator = *self.random.pick(&[Arithmetic::Divide, Arithmetic::Modulo]);
                let left = self.boxed(ty, depth);
                let mut right = self.constant(ty);
                if !matches!(&right.kind, ExprKind::Constant(Constant::Integer(value)) if *value != 0)
                    || self.random.one_in(2)
                {
                    // Odd, so not zero.
                    let any = self.boxed(ty, depth);
                    let one = self.node(ty, ExprKind::Constant(Constant::Integer(1)));
                    let zeros = self.random.one_in(12);
                    let or = if zeros { Arithmetic::And } else { Arithmetic::Or };
                    right = self.node(ty, ExprKind::Arithmetic(or, any, Box::new(one)));
                }
                ExprKind::Arithmetic(operator, left, Box::new(right))
            }
            9 if elementary.class() == Class::Signed => {
                ExprKind::Intrinsic(Intrinsic::Abs, vec![self.expr(ty, depth)])
            }
            10 => ExprKind::Arithmetic(
                *self.random.pick(&[Arithmetic::And, Arithmetic::Or, Arithmetic::Xor]),
                self.boxed(ty, depth),
                self.boxed(ty, depth),
            ),
            _ => ExprKind::Arithmetic(
                *self.random.pick(&[Arithmetic::Add, Arithmetic::Subtract, Arithmetic::Multiply]),
                self.boxed(ty, depth),
                self.boxed(ty, depth),
            ),
        }
    }

    /// A string. Its parts have types that are large enough for them.
    fn text(&mut self, ty: TypeId, depth: u32, wide: bool) -> Expr {
        let lint = self.elementary(Elementary::Lint);
        let unit = self.elementary(if wide { Elementary::Word } else { Elementary::Byte });
        use Intrinsic::*;
        let kind = match self.random.below(7) {
            0 => ExprKind::Intrinsic(
                *self.random.pick(&[Left, Right]),
                vec![self.expr(ty, depth), self.small(lint, depth)],
            ),
            1 => ExprKind::Intrinsic(
                Mid,
                vec![self.expr(ty, depth), self.small(lint, depth), self.small(lint, depth)],
            ),
            2 => self.select(ty, depth),
            3 => ExprKind::Intrinsic(FromUnit, vec![self.expr(unit, depth)]),
            4 => ExprKind::Intrinsic(
                *self.random.pick(&[Min, Max]),
                vec![self.expr(ty, depth), self.expr(ty, depth)],
            ),
            _ => ExprKind::Intrinsic(Concat, vec![self.expr(ty, depth), self.expr(ty, depth)]),
        };
        self.node(ty, kind)
    }

    fn small(&mut self, lint: TypeId, depth: u32) -> Expr {
        if self.random.one_in(4) {
            return self.expr(lint, depth);
        }
        let value = Constant::Integer(self.random.below(10) as i128 - 1);
        self.node(lint, ExprKind::Constant(value))
    }

    fn call_with_result(&mut self, ty: TypeId, depth: u32) -> Option<Expr> {
        let fitting: Vec<Callable> =
            self.functions.iter().filter(|function| function.result == Some(ty)).cloned().collect();
        if fitting.is_empty() {
            return None;
        }
        let function = self.random.pick(&fitting).clone();
        let arguments = self.arguments(&function, depth)?;
        Some(self.node(ty, ExprKind::Call(function.id, arguments)))
    }

    /// Arguments for a call, or `None` if there is nothing to pass by reference.
    pub fn arguments(&mut self, function: &Callable, depth: u32) -> Option<Vec<Argument>> {
        let mut arguments = Vec::new();
        for parameter in &function.parameters {
            let writable = self.writable.clone();
            arguments.push(match parameter.kind {
                LocalKind::Input
                    if self.program.types.scalar(parameter.ty).is_none()
                        && !self.program.types.is_string(parameter.ty) =>
                {
                    let readable = self.readable.clone();
                    let place = self.place_of(&readable, parameter.ty)?;
                    Argument::Value(self.node(parameter.ty, ExprKind::Load(place)))
                }
                LocalKind::Input => Argument::Value(self.expr(parameter.ty, depth)),
                LocalKind::InOut => {
                    let ty = match self.program.types.get(parameter.ty).clone() {
                        Type::OpenArray { element, .. } => self.program.types.array(element, -3, 4),
                        _ => parameter.ty,
                    };
                    let place =
                        self.place_of(&writable, ty).filter(|place| self.is_addressable(place))?;
                    Argument::Reference(place)
                }
                LocalKind::Output => Argument::Output(self.place_of(&writable, parameter.ty)),
                LocalKind::Variable => continue,
            });
        }
        Some(arguments)
    }
}
