//! Strings.
//!
//! The value of a string expression is a view: the address of its first unit and the number of units. So LEFT, RIGHT
//! and MID copy nothing. A view of a variable must not outlive a change of the variable: where something is evaluated
//! between the view and its use that calls a routine, the view is of a copy ([`Lower::stable_view`]).

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{InstBuilder, Value, types};

use super::expr::integer_condition;
use super::lower::Lower;
use super::place::Located;
use super::runtime::Function;
use super::target::MEMORY;
use super::walk;
use crate::hir::{Comparison, Constant, Expr, ExprKind, Intrinsic, TrapKind, Type, TypeId};
use takt_program::call::Call;

/// The units of a string.
#[derive(Clone, Copy)]
pub(super) struct View {
    /// The address of the first one.
    pub start: Value,
    /// How many, in 64 bits.
    pub units: Value,
}

impl Lower<'_> {
    pub(super) fn wide(&self, ty: TypeId) -> bool {
        matches!(self.program.types.get(ty), Type::WString { .. })
    }

    fn capacity(&self, ty: TypeId) -> i64 {
        match self.program.types.get(ty) {
            Type::String { capacity } | Type::WString { capacity } => i64::from(*capacity),
            other => unreachable!("{other:?} is no string"),
        }
    }

    pub(super) fn bytes(&mut self, units: Value, wide: bool) -> Value {
        if wide { self.builder.ins().ishl_imm_u(units, 1) } else { units }
    }

    fn least(&mut self, a: Value, b: Value) -> Value {
        let less = self.builder.ins().icmp(IntCC::SignedLessThan, a, b);
        self.builder.ins().select(less, a, b)
    }

    fn least_constant(&mut self, a: Value, b: i64) -> Value {
        let b = self.builder.ins().iconst(types::I64, b);
        self.least(a, b)
    }

    fn at_least_zero(&mut self, value: Value) -> Value {
        let zero = self.builder.ins().iconst(types::I64, 0);
        let negative = self.builder.ins().icmp(IntCC::SignedLessThan, value, zero);
        self.builder.ins().select(negative, zero, value)
    }

    /// The view of the string variable at an address. Its length is searched for each time, and never beyond the
    /// variable's end: what the variable holds may come from elsewhere.
    pub(super) fn view_at(&mut self, base: Value, offset: i32, ty: TypeId) -> View {
        let start = self.offset(base, offset);
        let capacity = self.capacity(ty);
        let most = self.builder.ins().iconst(types::I64, capacity);
        let function = if self.wide(ty) { Function::LengthUnits } else { Function::LengthBytes };
        match self.runtime(function, &[start, most], Some(types::I64)) {
            Some(units) => View { start, units },
            None => unreachable!("a length is a result"),
        }
    }

    /// The address of the character at a position, from 1, of the string variable at an address. A position outside of
    /// its length traps.
    pub(super) fn character(
        &mut self,
        base: Value,
        offset: i32,
        text: TypeId,
        position: &Expr,
    ) -> Value {
        // What is called for the position may change the string, so its length is searched for behind it. A position
        // of ULINT beyond 2^63 looks negative, and so like no position.
        let at = self.wide_index(position);
        let view = self.view_at(base, offset, text);
        let index = self.builder.ins().iadd_imm_s(at, -1);
        let beyond = self.builder.ins().icmp(IntCC::UnsignedGreaterThanOrEqual, index, view.units);
        self.trap_if(beyond, TrapKind::Bounds, position.location);
        let distance = self.bytes(index, self.wide(text));
        self.builder.ins().iadd(view.start, distance)
    }

    fn offset(&mut self, base: Value, offset: i32) -> Value {
        if offset == 0 { base } else { self.builder.ins().iadd_imm_s(base, i64::from(offset)) }
    }

    /// The value of a string expression.
    pub(super) fn view(&mut self, expr: &Expr) -> View {
        self.at(expr.location);
        match &expr.kind {
            ExprKind::Constant(constant) => {
                let bytes: Vec<u8> = match constant {
                    Constant::String(bytes) => bytes.clone(),
                    Constant::WString(units) => {
                        units.iter().flat_map(|unit| unit.to_le_bytes()).collect()
                    }
                    _ => Vec::new(),
                };
                let units = bytes.len() as i64 / if self.wide(expr.ty) { 2 } else { 1 };
                let units = self.builder.ins().iconst(types::I64, units);
                View { start: self.constant_address(bytes), units }
            }
            ExprKind::Load(place) => match self.locate(place) {
                Located::Memory(base, offset) => self.view_at(base, offset, place.ty),
                Located::Register(_) | Located::Bit(..) => unreachable!("a string is in memory"),
            },
            ExprKind::Call(routine, arguments) => {
                let address = self.call_into_temporary(*routine, arguments);
                self.view_at(address, 0, expr.ty)
            }
            ExprKind::Intrinsic(intrinsic, arguments) => {
                self.text_intrinsic(expr, *intrinsic, arguments)
            }
            other => unreachable!("{other:?} is no string"),
        }
    }

    /// A view that stays right while `then` is evaluated.
    pub(super) fn stable_view(&mut self, expr: &Expr, then: &[Expr]) -> View {
        if then.iter().any(walk::calls) { self.own_view(expr) } else { self.view(expr) }
    }

    /// A view of a copy in the frame.
    pub(super) fn own_view(&mut self, expr: &Expr) -> View {
        let view = self.view(expr);
        let slot = self.slot(self.program.types.size(expr.ty), 2);
        let start = self.builder.ins().stack_addr(types::I64, slot, 0);
        let units = self.assign_view(start, 0, expr.ty, view);
        View { start, units }
    }

    /// A copy of the value in the frame, as a variable of type `ty`.
    pub(super) fn text_temporary(&mut self, expr: &Expr, ty: TypeId) -> Value {
        let view = self.view(expr);
        let slot = self.slot(self.program.types.size(ty), 2);
        let address = self.builder.ins().stack_addr(types::I64, slot, 0);
        self.assign_view(address, 0, ty, view);
        address
    }

    /// Assigns a view to the variable at an address. The view may be of the same variable. Returns how many units
    /// were assigned.
    pub(super) fn assign_view(
        &mut self,
        base: Value,
        offset: i32,
        ty: TypeId,
        view: View,
    ) -> Value {
        let wide = self.wide(ty);
        let units = self.least_constant(view.units, self.capacity(ty));
        let bytes = self.bytes(units, wide);
        let to = self.offset(base, offset);
        self.runtime(Function::Copy, &[to, view.start, bytes], None);
        let end = self.builder.ins().iadd(to, bytes);
        let zero = self.builder.ins().iconst(if wide { types::I16 } else { types::I8 }, 0);
        self.builder.ins().store(MEMORY, zero, end, 0);
        units
    }

    /// Writes a line to the log. The kernel refuses a line that is too long, so the end is cut.
    pub(super) fn log(&mut self, line: &Expr) -> Value {
        let View { start, units } = self.view(line);
        let bytes = self.least_constant(units, i64::from(takt_program::limit::LOG_BYTES));
        self.system(Call::Log.code(), &[start, bytes])
    }

    pub(super) fn compare_text(
        &mut self,
        comparison: Comparison,
        left: &Expr,
        right: &Expr,
    ) -> Value {
        let a = self.stable_view(left, std::slice::from_ref(right));
        let b = self.view(right);
        self.compare_views(comparison, a, b, self.wide(left.ty))
    }

    fn compare_views(&mut self, comparison: Comparison, a: View, b: View, wide: bool) -> Value {
        let function = if wide { Function::CompareUnits } else { Function::CompareBytes };
        let arguments = [a.start, a.units, b.start, b.units];
        let Some(order) = self.runtime(function, &arguments, Some(types::I64)) else {
            unreachable!("a comparison has a result")
        };
        self.builder.ins().icmp_imm_s(integer_condition(comparison, true), order, 0)
    }

    fn chosen(&mut self, choice: Value, one: View, zero: View) -> View {
        View {
            start: self.builder.ins().select(choice, one.start, zero.start),
            units: self.builder.ins().select(choice, one.units, zero.units),
        }
    }

    pub(super) fn find(&mut self, text: &Expr, sought: &Expr) -> Value {
        let function = if self.wide(text.ty) { Function::FindUnits } else { Function::FindBytes };
        let a = self.stable_view(text, std::slice::from_ref(sought));
        let b = self.view(sought);
        match self.runtime(function, &[a.start, a.units, b.start, b.units], Some(types::I64)) {
            Some(position) => position,
            None => unreachable!("a search has a result"),
        }
    }

    pub(super) fn unit_at(
        &mut self,
        start: Value,
        units: Value,
        position: Value,
        wide: bool,
    ) -> Value {
        let (ty, shift) = if wide { (types::I16, 1) } else { (types::I8, 0) };
        let index = self.builder.ins().iadd_imm_s(position, -1);
        let within = self.builder.ins().icmp(IntCC::UnsignedLessThan, index, units);
        let (read, end) = (self.builder.create_block(), self.builder.create_block());
        let result = self.builder.append_block_param(end, ty);
        let zero = self.builder.ins().iconst(ty, 0);
        self.builder.ins().brif(within, read, &[], end, &[zero.into()]);
        self.builder.switch_to_block(read);
        let distance = self.builder.ins().ishl_imm_u(index, shift);
        let address = self.builder.ins().iadd(start, distance);
        let unit = self.builder.ins().load(ty, MEMORY, address, 0);
        self.builder.ins().jump(end, &[unit.into()]);
        self.builder.switch_to_block(end);
        result
    }

    fn text_intrinsic(&mut self, expr: &Expr, intrinsic: Intrinsic, arguments: &[Expr]) -> View {
        let wide = self.wide(expr.ty);
        match intrinsic {
            Intrinsic::Left | Intrinsic::Right | Intrinsic::Mid => {
                self.part(intrinsic, arguments, wide)
            }
            Intrinsic::Select => {
                let choice = self.expr(&arguments[0]);
                let zero = self.stable_view(&arguments[1], &arguments[2..]);
                let one = self.view(&arguments[2]);
                self.chosen(choice, one, zero)
            }
            Intrinsic::Min | Intrinsic::Max => {
                let a = self.stable_view(&arguments[0], &arguments[1..]);
                let b = self.view(&arguments[1]);
                let comparison = match intrinsic {
                    Intrinsic::Min => Comparison::Less,
                    _ => Comparison::Greater,
                };
                let first = self.compare_views(comparison, a, b, wide);
                self.chosen(first, a, b)
            }
            Intrinsic::Concat => {
                let a = self.stable_view(&arguments[0], &arguments[1..]);
                let b = self.view(&arguments[1]);
                self.concatenate(expr.ty, a, b, wide)
            }
            Intrinsic::FromUnit => {
                let unit = self.expr(&arguments[0]);
                let slot = self.slot(8, 8);
                let start = self.builder.ins().stack_addr(types::I64, slot, 0);
                self.builder.ins().store(MEMORY, unit, start, 0);
                // Character 0 ends a text.
                let some = self.builder.ins().icmp_imm_s(IntCC::NotEqual, unit, 0);
                let units = self.builder.ins().uextend(types::I64, some);
                let units = self.least_constant(units, self.capacity(expr.ty));
                View { start, units }
            }
            other => unreachable!("{other:?} is no string"),
        }
    }

    fn part(&mut self, intrinsic: Intrinsic, arguments: &[Expr], wide: bool) -> View {
        let text = self.stable_view(&arguments[0], &arguments[1..]);
        let count = self.expr(&arguments[1]);
        let count = self.at_least_zero(count);
        match intrinsic {
            Intrinsic::Left => View { start: text.start, units: self.least(count, text.units) },
            Intrinsic::Right => {
                let units = self.least(count, text.units);
                let skipped = self.builder.ins().isub(text.units, units);
                let skipped = self.bytes(skipped, wide);
                View { start: self.builder.ins().iadd(text.start, skipped), units }
            }
            _ => {
                let position = self.expr(&arguments[2]);
                // No sum wraps: the one below is of a number below zero and one above.
                let least = self.builder.ins().iconst(types::I64, i64::MIN + 1);
                let representable =
                    self.builder.ins().icmp(IntCC::SignedGreaterThan, position, least);
                let position = self.builder.ins().select(representable, position, least);
                let first = self.builder.ins().iadd_imm_s(position, -1);
                let before = self.builder.ins().icmp_imm_s(IntCC::SignedLessThan, first, 0);
                let left_over = self.builder.ins().iadd(count, first);
                let left_over = self.at_least_zero(left_over);
                let wanted = self.builder.ins().select(before, left_over, count);
                let first = self.at_least_zero(first);
                let first = self.least(first, text.units);
                let rest = self.builder.ins().isub(text.units, first);
                let units = self.least(wanted, rest);
                let skipped = self.bytes(first, wide);
                View { start: self.builder.ins().iadd(text.start, skipped), units }
            }
        }
    }

    fn concatenate(&mut self, ty: TypeId, a: View, b: View, wide: bool) -> View {
        let capacity = self.capacity(ty);
        let slot = self.slot(self.program.types.size(ty), 2);
        let start = self.builder.ins().stack_addr(types::I64, slot, 0);
        let first = self.least_constant(a.units, capacity);
        let room = self.builder.ins().iconst(types::I64, capacity);
        let room = self.builder.ins().isub(room, first);
        let second = self.least(b.units, room);
        let first_bytes = self.bytes(first, wide);
        let second_bytes = self.bytes(second, wide);
        self.runtime(Function::Copy, &[start, a.start, first_bytes], None);
        let behind = self.builder.ins().iadd(start, first_bytes);
        self.runtime(Function::Copy, &[behind, b.start, second_bytes], None);
        View { start, units: self.builder.ins().iadd(first, second) }
    }
}
