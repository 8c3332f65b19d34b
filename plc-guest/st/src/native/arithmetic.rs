//! Arithmetic, shifts, and functions of reals.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{InstBuilder, Value, types};

use super::effects::Target;
use super::lower::Lower;
use super::runtime::Function;
use super::target::register;
use crate::hir::{
    Arithmetic, Class, Constant, Elementary, Expr, ExprKind, Intrinsic, TrapKind, Type,
};

impl Lower<'_> {
    pub(super) fn arithmetic(
        &mut self,
        expr: &Expr,
        operator: Arithmetic,
        left: &Expr,
        right: &Expr,
    ) -> Value {
        let ty = self.scalar(expr.ty);
        if ty.class() == Class::Float {
            return self.arithmetic_of_reals(expr, operator, left, right);
        }
        let (a, b) = (self.expr(left), self.expr(right));
        self.at(expr.location);
        let ins = self.builder.ins();
        match (operator, ty.class()) {
            (Arithmetic::Add, _) => ins.iadd(a, b),
            (Arithmetic::Subtract, _) => ins.isub(a, b),
            (Arithmetic::Multiply, _) => ins.imul(a, b),
            (Arithmetic::And, _) => ins.band(a, b),
            (Arithmetic::Or, _) => ins.bor(a, b),
            (Arithmetic::Xor, _) => ins.bxor(a, b),
            (Arithmetic::Divide | Arithmetic::Modulo, _) => {
                self.divide(expr, operator, (left, a), (right, b), ty)
            }
        }
    }

    /// A constant costs nothing as the right operand, if the left one is in a register: it is read from where it lies.
    /// Where the left one is read from memory itself, a constant in a register is better, which a loop keeps.
    fn arithmetic_of_reals(
        &mut self,
        expr: &Expr,
        operator: Arithmetic,
        left: &Expr,
        right: &Expr,
    ) -> Value {
        let commutes = matches!(operator, Arithmetic::Add | Arithmetic::Multiply);
        // Only the bits of a NaN depend on the order of these two, and no program may rely on them.
        let (left, right) =
            if commutes && is_constant(left) { (right, left) } else { (left, right) };
        let a = self.in_register(left);
        let b = if commutes && self.reads_memory(left) {
            self.in_register(right)
        } else {
            self.expr(right)
        };
        self.at(expr.location);
        let ins = self.builder.ins();
        match operator {
            Arithmetic::Add => ins.fadd(a, b),
            Arithmetic::Subtract => ins.fsub(a, b),
            Arithmetic::Multiply => ins.fmul(a, b),
            Arithmetic::Divide => ins.fdiv(a, b),
            other => unreachable!("{other:?} of reals"),
        }
    }

    fn reads_memory(&self, expr: &Expr) -> bool {
        let ExprKind::Load(place) = &expr.kind else { return false };
        match self.target(place) {
            Target::Cell(cell) => self.register_of(&cell).is_none(),
            _ => true,
        }
    }

    /// An integer division. The processor faults for a divisor of 0, which traps here before, and for the least integer
    /// by -1, whose quotient is itself here.
    fn divide(
        &mut self,
        expr: &Expr,
        operator: Arithmetic,
        (left, a): (&Expr, Value),
        (right, b): (&Expr, Value),
        ty: Elementary,
    ) -> Value {
        let divisor = self.range(right);
        if divisor.0 <= 0 && divisor.1 >= 0 {
            let zero = self.builder.ins().icmp_imm_s(IntCC::Equal, b, 0);
            self.trap_if(zero, TrapKind::ZeroDivide, expr.location);
        }
        let signed = ty.class() == Class::Signed;
        if ty.size() < 4 {
            // In 32 bits no quotient of narrower numbers overflows.
            let (a, b) = if signed {
                (
                    self.builder.ins().sextend(types::I32, a),
                    self.builder.ins().sextend(types::I32, b),
                )
            } else {
                (
                    self.builder.ins().uextend(types::I32, a),
                    self.builder.ins().uextend(types::I32, b),
                )
            };
            let wide = self.quotient(operator, signed, a, b);
            return self.builder.ins().ireduce(register(ty), wide);
        }
        let least = ty.range().map_or(0, |(least, _)| least);
        let overflows = signed && divisor.0 <= -1 && divisor.1 >= -1 && self.range(left).0 == least;
        if !overflows {
            return self.quotient(operator, signed, a, b);
        }
        // Division by 1 instead, and then the sign: no branch, and no fault.
        let minus_one = self.builder.ins().icmp_imm_s(IntCC::Equal, b, -1);
        let one = self.builder.ins().iconst(register(ty), 1);
        let harmless = self.builder.ins().select(minus_one, one, b);
        let quotient = self.quotient(operator, signed, a, harmless);
        match operator {
            Arithmetic::Divide => {
                let negated = self.builder.ins().ineg(quotient);
                self.builder.ins().select(minus_one, negated, quotient)
            }
            // The remainder by 1 is that by -1: 0.
            _ => quotient,
        }
    }

    fn quotient(&mut self, operator: Arithmetic, signed: bool, a: Value, b: Value) -> Value {
        let ins = self.builder.ins();
        match (operator, signed) {
            (Arithmetic::Divide, true) => ins.sdiv(a, b),
            (Arithmetic::Divide, false) => ins.udiv(a, b),
            (_, true) => ins.srem(a, b),
            (_, false) => ins.urem(a, b),
        }
    }

    pub(super) fn shift(&mut self, expr: &Expr, intrinsic: Intrinsic, arguments: &[Expr]) -> Value {
        let ty = self.scalar(expr.ty);
        let width = i128::from(ty.size()) * 8;
        let value = self.expr(&arguments[0]);
        let count = self.expr(&arguments[1]);
        let (low, high) = self.range(&arguments[1]);
        let ins = self.builder.ins();
        let shifted = match intrinsic {
            // A rotation takes the count modulo the width, as the processor does.
            Intrinsic::RotateLeft => return ins.rotl(value, count),
            Intrinsic::RotateRight => return ins.rotr(value, count),
            Intrinsic::ShiftLeft => ins.ishl(value, count),
            _ => ins.ushr(value, count),
        };
        if low >= 0 && high < width {
            return shifted;
        }
        let gone =
            self.builder.ins().icmp_imm_s(IntCC::SignedGreaterThanOrEqual, count, width as i64);
        let zero = self.builder.ins().iconst(register(ty), 0);
        let shifted = self.builder.ins().select(gone, zero, shifted);
        let none = self.builder.ins().icmp_imm_s(IntCC::SignedLessThan, count, 0);
        self.builder.ins().select(none, value, shifted)
    }

    pub(super) fn function_of_reals(
        &mut self,
        expr: &Expr,
        intrinsic: Intrinsic,
        arguments: &[Expr],
    ) -> Value {
        let real = self.scalar(expr.ty) == Elementary::Real;
        let (long, short) = match intrinsic {
            Intrinsic::Ln => (Function::Ln, Function::LnReal),
            Intrinsic::Log => (Function::Log, Function::LogReal),
            Intrinsic::Exp => (Function::Exp, Function::ExpReal),
            Intrinsic::Sin => (Function::Sin, Function::SinReal),
            Intrinsic::Cos => (Function::Cos, Function::CosReal),
            Intrinsic::Tan => (Function::Tan, Function::TanReal),
            Intrinsic::Asin => (Function::Asin, Function::AsinReal),
            Intrinsic::Acos => (Function::Acos, Function::AcosReal),
            Intrinsic::Atan => (Function::Atan, Function::AtanReal),
            Intrinsic::Atan2 => (Function::Atan2, Function::Atan2Real),
            Intrinsic::Power => (Function::Power, Function::PowerReal),
            other => unreachable!("{other:?} is no function of reals"),
        };
        let values: Vec<Value> = arguments.iter().map(|argument| self.expr(argument)).collect();
        let result = register(self.scalar(expr.ty));
        match self.runtime(if real { short } else { long }, &values, Some(result)) {
            Some(value) => value,
            None => unreachable!("a function of reals has a result"),
        }
    }

    /// Bounds of an integer expression's value that are known before the program runs; for others, what is no bound.
    pub(super) fn range(&self, expr: &Expr) -> (i128, i128) {
        let Some(all) = self.program.types.scalar(expr.ty).and_then(Elementary::range) else {
            return (i128::MIN, i128::MAX);
        };
        let narrower = match &expr.kind {
            ExprKind::Constant(Constant::Integer(value)) => Some((*value, *value)),
            ExprKind::Load(place) => match self.target(place) {
                Target::Cell(cell) => self.ranges.get(&cell).copied(),
                _ => None,
            },
            ExprKind::Convert(crate::hir::Conversion::Value, operand) => self
                .program
                .types
                .scalar(operand.ty)
                .and_then(Elementary::range)
                .map(|_| self.range(operand)),
            ExprKind::Arithmetic(operator, left, right) => {
                let (a, b) = (self.range(left), self.range(right));
                match operator {
                    Arithmetic::Add => Some((a.0 + b.0, a.1 + b.1)),
                    Arithmetic::Subtract => Some((a.0 - b.1, a.1 - b.0)),
                    Arithmetic::Multiply
                        if a.0 >= 0 && b.0 >= 0 && a.1 < 1 << 62 && b.1 < 1 << 62 =>
                    {
                        Some((a.0 * b.0, a.1 * b.1))
                    }
                    Arithmetic::Divide if a.0 >= 0 && b.0 > 0 => Some((a.0 / b.1, a.1 / b.0)),
                    Arithmetic::Modulo if a.0 >= 0 && b.0 > 0 => Some((0, a.1.min(b.1 - 1))),
                    Arithmetic::And if a.0 >= 0 && b.0 >= 0 => Some((0, a.1.min(b.1))),
                    _ => None,
                }
            }
            ExprKind::Intrinsic(intrinsic, arguments) => self.range_of(*intrinsic, arguments),
            _ => None,
        };
        // What leaves the type's range has wrapped.
        narrower.filter(|(low, high)| *low >= all.0 && *high <= all.1).unwrap_or(all)
    }

    fn range_of(&self, intrinsic: Intrinsic, arguments: &[Expr]) -> Option<(i128, i128)> {
        match (intrinsic, arguments) {
            (Intrinsic::Min, [a, b]) => {
                let (a, b) = (self.range(a), self.range(b));
                Some((a.0.min(b.0), a.1.min(b.1)))
            }
            (Intrinsic::Max, [a, b]) => {
                let (a, b) = (self.range(a), self.range(b));
                Some((a.0.max(b.0), a.1.max(b.1)))
            }
            (Intrinsic::Length, [text]) => match self.program.types.get(text.ty) {
                Type::String { capacity } | Type::WString { capacity } => {
                    Some((0, i128::from(*capacity)))
                }
                _ => None,
            },
            _ => None,
        }
    }
}

fn is_constant(expr: &Expr) -> bool {
    matches!(expr.kind, ExprKind::Constant(_))
}
