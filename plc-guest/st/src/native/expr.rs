//! Expressions of scalar types.

use cranelift_codegen::ir::condcodes::{FloatCC, IntCC};
use cranelift_codegen::ir::{InstBuilder, Value, types};
use takt_program::TaskInformation;

use super::lower::{Home, Lower};
use super::target::{MEMORY, address, register};
use super::text::View;
use crate::hir::{
    Class, Comparison, Constant, Elementary, Expr, ExprKind, Intrinsic, Root, Type, TypeId,
    UnaryOperator,
};

/// Offsets of the task's information, see the crate of the program image.
const CYCLE: i32 = 8;
const NOW: i32 = 16;
const ELAPSED: i32 = 24;

impl Lower<'_> {
    /// The value of an expression of a scalar type.
    pub(super) fn expr(&mut self, expr: &Expr) -> Value {
        self.at(expr.location);
        match &expr.kind {
            ExprKind::Constant(constant) => self.constant(expr.ty, constant),
            ExprKind::Load(place) => {
                let located = self.locate(place);
                self.load(located, place.ty)
            }
            ExprKind::Unary(operator, operand) => {
                let value = self.expr(operand);
                match (operator, self.scalar(expr.ty).class()) {
                    (UnaryOperator::Negate, Class::Float) => self.builder.ins().fneg(value),
                    (UnaryOperator::Negate, _) => self.builder.ins().ineg(value),
                    (UnaryOperator::Not, Class::Bool) => self.builder.ins().bxor_imm_u(value, 1),
                    (UnaryOperator::Not, _) => self.builder.ins().bnot(value),
                }
            }
            ExprKind::Arithmetic(operator, left, right) => {
                self.arithmetic(expr, *operator, left, right)
            }
            ExprKind::Compare(comparison, left, right) => self.compare(*comparison, left, right),
            ExprKind::AndThen(left, right) => self.shortcut(left, right, false),
            ExprKind::OrElse(left, right) => self.shortcut(left, right, true),
            ExprKind::Convert(conversion, operand) => self.convert(expr, *conversion, operand),
            ExprKind::Call(routine, arguments) => match self.call(*routine, arguments) {
                Some(value) => value,
                None => unreachable!("a function with a scalar result"),
            },
            ExprKind::Intrinsic(intrinsic, arguments) => {
                self.intrinsic(expr, *intrinsic, arguments)
            }
            ExprKind::Reference(place) => self.address(place),
            ExprKind::Bound { place, dimension, upper } => {
                let Root::Local(id) = &place.root else {
                    unreachable!("an open array is a parameter")
                };
                let Home::Open(_, bounds) = &self.homes[id.0 as usize] else {
                    unreachable!("an open array is a VAR_IN_OUT")
                };
                let (low, high) = bounds[usize::from(*dimension)];
                self.builder.use_var(if *upper { high } else { low })
            }
        }
    }

    /// A constant of a scalar type.
    pub(super) fn constant(&mut self, ty: TypeId, constant: &Constant) -> Value {
        let scalar = self.scalar(ty);
        let real = match constant {
            Constant::Real(value) => *value,
            _ => 0.0,
        };
        match scalar {
            Elementary::Real => self.builder.ins().f32const(real as f32),
            Elementary::Lreal => self.builder.ins().f64const(real),
            _ => {
                let value = match constant {
                    Constant::Integer(value) => *value,
                    Constant::Address(global, fields) => {
                        i128::from(super::field_address(self.program, *global, fields))
                    }
                    _ => self.program.types.first_value(ty),
                };
                self.integer(scalar, value)
            }
        }
    }

    /// The value of an expression that is wanted in a register. For a constant of REAL and LREAL this is one load from
    /// the constants, which leaves loops; Cranelift would make it anew, in two instructions, wherever it is used.
    pub(super) fn in_register(&mut self, expr: &Expr) -> Value {
        let (ExprKind::Constant(constant), Type::Elementary(scalar)) =
            (&expr.kind, self.program.types.get(expr.ty))
        else {
            return self.expr(expr);
        };
        let real = match constant {
            Constant::Real(value) => *value,
            _ => 0.0,
        };
        let (vector, mut bytes) = match scalar {
            Elementary::Real => (types::F32X4, (real as f32).to_le_bytes().to_vec()),
            Elementary::Lreal => (types::F64X2, real.to_le_bytes().to_vec()),
            _ => return self.expr(expr),
        };
        if bytes.iter().all(|byte| *byte == 0) {
            return self.expr(expr);
        }
        bytes.resize(16, 0);
        self.at(expr.location);
        let constant = self.builder.func.dfg.constants.insert(bytes.into());
        let both = self.builder.ins().vconst(vector, constant);
        self.builder.ins().extractlane(both, 0)
    }

    /// An integer constant. Cranelift wants the bits above the type's width to be zero.
    pub(super) fn integer(&mut self, ty: Elementary, value: i128) -> Value {
        let bits = match ty.size() {
            8 => value as i64,
            size => (value as i64) & ((1 << (size * 8)) - 1),
        };
        self.builder.ins().iconst(register(ty), bits)
    }

    fn shortcut(&mut self, left: &Expr, right: &Expr, decided_by: bool) -> Value {
        let (other, end) = (self.builder.create_block(), self.builder.create_block());
        let result = self.builder.append_block_param(end, types::I8);
        let first = self.expr(left);
        let first_argument = [first.into()];
        if decided_by {
            self.builder.ins().brif(first, end, &first_argument, other, &[]);
        } else {
            self.builder.ins().brif(first, other, &[], end, &first_argument);
        }
        self.builder.switch_to_block(other);
        let second = self.expr(right);
        self.builder.ins().jump(end, &[second.into()]);
        self.builder.switch_to_block(end);
        result
    }

    pub(super) fn compare(&mut self, comparison: Comparison, left: &Expr, right: &Expr) -> Value {
        if self.program.types.is_string(left.ty) {
            return self.compare_text(comparison, left, right);
        }
        let class = self.scalar(left.ty).class();
        let (left, right) = match comparison {
            // The processor compares the greater one with what may be in memory.
            Comparison::Less | Comparison::LessEqual => (self.expr(left), self.in_register(right)),
            _ => (self.in_register(left), self.expr(right)),
        };
        if class == Class::Float {
            let condition = match comparison {
                Comparison::Equal => FloatCC::Equal,
                Comparison::NotEqual => FloatCC::NotEqual,
                Comparison::Less => FloatCC::LessThan,
                Comparison::LessEqual => FloatCC::LessThanOrEqual,
                Comparison::Greater => FloatCC::GreaterThan,
                Comparison::GreaterEqual => FloatCC::GreaterThanOrEqual,
            };
            return self.builder.ins().fcmp(condition, left, right);
        }
        self.builder.ins().icmp(integer_condition(comparison, class == Class::Signed), left, right)
    }

    fn intrinsic(&mut self, expr: &Expr, intrinsic: Intrinsic, arguments: &[Expr]) -> Value {
        use Intrinsic::*;
        match intrinsic {
            Now => self.information(NOW),
            Elapsed => self.information(ELAPSED),
            Cycle => self.information(CYCLE),
            Select => {
                let choice = self.expr(&arguments[0]);
                let zero = self.in_register(&arguments[1]);
                let one = self.in_register(&arguments[2]);
                self.builder.ins().select(choice, one, zero)
            }
            Min | Max => {
                let class = self.scalar(expr.ty).class();
                let (left, right) = (self.in_register(&arguments[0]), self.expr(&arguments[1]));
                let comparison =
                    if intrinsic == Min { Comparison::Less } else { Comparison::Greater };
                // "Less" in both cases: in this form Cranelift knows the instructions of the processor.
                let first = match (class, intrinsic) {
                    (Class::Float, Min) => self.builder.ins().fcmp(FloatCC::LessThan, left, right),
                    (Class::Float, _) => self.builder.ins().fcmp(FloatCC::LessThan, right, left),
                    (class, _) => {
                        let condition = integer_condition(comparison, class == Class::Signed);
                        self.builder.ins().icmp(condition, left, right)
                    }
                };
                self.builder.ins().select(first, left, right)
            }
            Limit => {
                let least = self.in_register(&arguments[0]);
                let value = self.in_register(&arguments[1]);
                let most = self.in_register(&arguments[2]);
                // Forms of which Cranelift knows the instructions, too. They give the second operand if one is NaN.
                let low = self.builder.ins().fcmp(FloatCC::LessThan, value, least);
                let raised = self.builder.ins().select(low, least, value);
                let high = self.builder.ins().fcmp(FloatCC::LessThan, most, raised);
                self.builder.ins().select(high, most, raised)
            }
            Abs => {
                let value = self.expr(&arguments[0]);
                match self.scalar(expr.ty).class() {
                    Class::Float => self.builder.ins().fabs(value),
                    Class::Signed => self.builder.ins().iabs(value),
                    _ => value,
                }
            }
            Sqrt => {
                let value = self.expr(&arguments[0]);
                self.builder.ins().sqrt(value)
            }
            ShiftLeft | ShiftRight | RotateLeft | RotateRight => {
                self.shift(expr, intrinsic, arguments)
            }
            Ln | Log | Exp | Sin | Cos | Tan | Asin | Acos | Atan | Atan2 | Power => {
                self.function_of_reals(expr, intrinsic, arguments)
            }
            Length => self.view(&arguments[0]).units,
            Find => self.find(&arguments[0], &arguments[1]),
            UnitAt => {
                let wide = matches!(self.program.types.get(arguments[0].ty), Type::WString { .. });
                let View { start, units } = self.stable_view(&arguments[0], &arguments[1..]);
                let position = self.expr(&arguments[1]);
                self.unit_at(start, units, position, wide)
            }
            LogLine => self.log(&arguments[0]),
            ChannelRead(channel) => self.channel_read(channel, &arguments[0]),
            ChannelWrite(channel) => self.channel_write(channel, &arguments[0], &arguments[1]),
            Simulate(simulation) => {
                let value = self.expr(&arguments[0]);
                self.system(simulation as u32, &[value])
            }
            Left | Right | Mid | Concat | FromUnit => unreachable!("{intrinsic:?} is a string"),
        }
    }

    /// A word of what the kernel tells the task that this runs in. Which one that is, the slot of its stack says: a block or a
    /// function may be called by several.
    fn information(&mut self, offset: i32) -> Value {
        const FIRST: u64 = address::STACKS / address::STACK_SLOT;
        const BYTES: u64 = size_of::<TaskInformation>() as u64;
        let stack = self.builder.ins().get_stack_pointer(types::I64);
        let slot =
            self.builder.ins().ushr_imm_u(stack, i64::from(address::STACK_SLOT.trailing_zeros()));
        let place = self.builder.ins().ishl_imm_u(slot, i64::from(BYTES.trailing_zeros()));
        let first = (address::TASK_INFORMATION - FIRST * BYTES) as i32;
        self.builder.ins().load(types::I64, MEMORY, place, first + offset)
    }
}

/// The condition of a comparison of integers.
pub(super) fn integer_condition(comparison: Comparison, signed: bool) -> IntCC {
    match (comparison, signed) {
        (Comparison::Equal, _) => IntCC::Equal,
        (Comparison::NotEqual, _) => IntCC::NotEqual,
        (Comparison::Less, true) => IntCC::SignedLessThan,
        (Comparison::Less, false) => IntCC::UnsignedLessThan,
        (Comparison::LessEqual, true) => IntCC::SignedLessThanOrEqual,
        (Comparison::LessEqual, false) => IntCC::UnsignedLessThanOrEqual,
        (Comparison::Greater, true) => IntCC::SignedGreaterThan,
        (Comparison::Greater, false) => IntCC::UnsignedGreaterThan,
        (Comparison::GreaterEqual, true) => IntCC::SignedGreaterThanOrEqual,
        (Comparison::GreaterEqual, false) => IntCC::UnsignedGreaterThanOrEqual,
    }
}
