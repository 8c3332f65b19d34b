//! Conversions between scalar types.

use cranelift_codegen::ir::condcodes::{FloatCC, IntCC};
use cranelift_codegen::ir::{InstBuilder, MemFlagsData, Value, types};

use super::expr::integer_condition;
use super::lower::Lower;
use super::target::register;
use crate::hir::{Class, Comparison, Conversion, Elementary, Expr, TrapKind, Type};

impl Lower<'_> {
    pub(super) fn convert(&mut self, expr: &Expr, conversion: Conversion, operand: &Expr) -> Value {
        let (from, to) = (self.scalar(operand.ty), self.scalar(expr.ty));
        let value = self.expr(operand);
        match conversion {
            Conversion::Check => {
                self.check(expr, operand, value);
                value
            }
            Conversion::Bits => match (from.class() == Class::Float, to.class() == Class::Float) {
                (float, to_float) if float == to_float => value,
                _ => self.builder.ins().bitcast(register(to), MemFlagsData::new(), value),
            },
            Conversion::Value if (from, to) == (Elementary::Wchar, Elementary::Char) => {
                let foreign =
                    self.builder.ins().icmp_imm_s(IntCC::UnsignedGreaterThan, value, 0xFF);
                let mark = self.builder.ins().iconst(types::I16, i64::from(b'?'));
                let value = self.builder.ins().select(foreign, mark, value);
                self.builder.ins().ireduce(types::I8, value)
            }
            Conversion::Value | Conversion::Truncate => match (from.class(), to.class()) {
                (Class::Float, Class::Float) => match (from, to) {
                    (Elementary::Real, Elementary::Lreal) => {
                        self.builder.ins().fpromote(types::F64, value)
                    }
                    (Elementary::Lreal, Elementary::Real) => {
                        self.builder.ins().fdemote(types::F32, value)
                    }
                    _ => value,
                },
                (Class::Float, Class::Bool) => {
                    let zero = if from == Elementary::Real {
                        self.builder.ins().f32const(0.0)
                    } else {
                        self.builder.ins().f64const(0.0)
                    };
                    self.builder.ins().fcmp(FloatCC::NotEqual, value, zero)
                }
                (Class::Float, _) => {
                    let whole = match conversion {
                        Conversion::Truncate => value,
                        _ => self.builder.ins().nearest(value),
                    };
                    self.real_to_integer(whole, to)
                }
                (Class::Signed, Class::Float) => {
                    let value = if from.size() < 4 {
                        self.builder.ins().sextend(types::I32, value)
                    } else {
                        value
                    };
                    self.builder.ins().fcvt_from_sint(register(to), value)
                }
                (_, Class::Float) => {
                    // Below 64 bits an unsigned number is a signed one of 64 bits, which the processor converts.
                    let value = self.widen(value, from, false);
                    if from.size() < 8 {
                        self.builder.ins().fcvt_from_sint(register(to), value)
                    } else {
                        self.builder.ins().fcvt_from_uint(register(to), value)
                    }
                }
                (Class::Bool, _) if to.size() == 1 => value,
                (_, Class::Bool) => self.builder.ins().icmp_imm_s(IntCC::NotEqual, value, 0),
                (class, _) => self.resize(value, from, to, class == Class::Signed),
            },
        }
    }

    fn resize(&mut self, value: Value, from: Elementary, to: Elementary, signed: bool) -> Value {
        match (from.size(), to.size()) {
            (old, new) if old == new => value,
            (old, new) if old > new => self.builder.ins().ireduce(register(to), value),
            _ if signed => self.builder.ins().sextend(register(to), value),
            _ => self.builder.ins().uextend(register(to), value),
        }
    }

    /// Towards zero, saturating, 0 for NaN.
    fn real_to_integer(&mut self, value: Value, to: Elementary) -> Value {
        match (to.class(), to.size()) {
            (Class::Signed, 4 | 8) => self.builder.ins().fcvt_to_sint_sat(register(to), value),
            (_, 4 | 8) => self.builder.ins().fcvt_to_uint_sat(register(to), value),
            (class, _) => {
                let wide = self.builder.ins().fcvt_to_sint_sat(types::I32, value);
                let (least, greatest) = to.range().unwrap_or((0, 0));
                let least = self.builder.ins().iconst(types::I32, least as i64 & 0xFFFF_FFFF);
                let greatest = self.builder.ins().iconst(types::I32, greatest as i64);
                debug_assert!(class != Class::Float);
                let below = self.builder.ins().icmp(IntCC::SignedLessThan, wide, least);
                let wide = self.builder.ins().select(below, least, wide);
                let above = self.builder.ins().icmp(IntCC::SignedGreaterThan, wide, greatest);
                let wide = self.builder.ins().select(above, greatest, wide);
                self.builder.ins().ireduce(register(to), wide)
            }
        }
    }

    fn check(&mut self, expr: &Expr, operand: &Expr, value: Value) {
        let Type::Subrange { base, lower, upper, .. } = *self.program.types.get(expr.ty) else {
            unreachable!("a check is of a subrange")
        };
        let known = self.range(operand);
        let signed = base.class() == Class::Signed;
        if known.0 < lower {
            let least = self.integer(base, lower);
            let condition = integer_condition(Comparison::Less, signed);
            let below = self.builder.ins().icmp(condition, value, least);
            self.trap_if(below, TrapKind::Subrange, expr.location);
        }
        if known.1 > upper {
            let greatest = self.integer(base, upper);
            let condition = integer_condition(Comparison::Greater, signed);
            let above = self.builder.ins().icmp(condition, value, greatest);
            self.trap_if(above, TrapKind::Subrange, expr.location);
        }
    }
}
