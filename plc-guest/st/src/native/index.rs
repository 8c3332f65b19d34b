//! Indices: checks of bounds, and distances in bytes.
//!
//! The index that a FOR counts costs least: it is known to be within its bounds or not before the program runs, needs
//! no extension, and what is added to it is a part of the address.

use std::collections::BTreeSet;

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{InstBuilder, Value, types};

use super::count::number;
use super::effects::{Target, constant_index};
use super::lower::{Home, Lower};
use super::walk;
use crate::hir::{
    self, Arithmetic, Class, Conversion, Elementary, Expr, ExprKind, Place, Root, Step, TrapKind,
    Type, TypeId,
};

/// A part of an address that is added when the program runs.
pub(super) struct Term {
    /// The loop in which it changes: the number of its counter, the outermost first, or the greatest number for what
    /// may change anywhere.
    pub changes: usize,
    /// In bytes.
    pub value: Value,
}

/// How far an element is from the beginning of its array.
pub(super) enum Distance {
    /// So many bytes.
    Constant(i64),
    /// What the term says.
    Term(Term),
    /// So many bytes more than the term says.
    From(Term, i64),
}

/// The factors that an address of x86-64 can have.
const FACTORS: [i64; 4] = [1, 2, 4, 8];

impl Lower<'_> {
    /// The distance of the element with this index, checked.
    pub(super) fn index(&mut self, index: &Expr, bounds: (i64, i64), size: i64) -> Distance {
        let (lower, upper) = bounds;
        if let Some(at) = constant_index(index, lower, upper) {
            return Distance::Constant(i64::from(at) * size);
        }
        let (low, high) = self.range(index);
        if low >= i128::from(lower) && high <= i128::from(upper) {
            if let Some((counter, more)) = self.counter_of(index) {
                let term = Term { changes: counter, value: self.multiple(counter, size) };
                return Distance::From(term, (more - lower) * size);
            }
            let at = self.wide_index(index);
            let term = Term { changes: usize::MAX, value: self.times(at, size) };
            return Distance::From(term, -lower * size);
        }
        let at = self.wide_index(index);
        if low >= 0 && high > i128::from(i64::MAX) && lower < 0 {
            // Only ULINT: what is beyond 2^63 looks negative here and must not pass.
            let beyond = self.builder.ins().icmp_imm_s(IntCC::SignedLessThan, at, 0);
            self.trap_if(beyond, TrapKind::Bounds, index.location);
        }
        // From the lower bound on: one unsigned comparison checks both bounds. The difference cannot wrap into the
        // bounds, because an array has fewer than 2^32 elements and the bounds are 64 bits wide.
        let from_zero = match lower {
            0 => at,
            lower => self.builder.ins().iadd_imm_s(at, lower.wrapping_neg()),
        };
        let last = upper.wrapping_sub(lower);
        let beyond = self.builder.ins().icmp_imm_s(IntCC::UnsignedGreaterThan, from_zero, last);
        self.trap_if(beyond, TrapKind::Bounds, index.location);
        Distance::Term(Term { changes: usize::MAX, value: self.times(from_zero, size) })
    }

    /// The counter that an index is a fixed distance from, and that distance. There is none if the sum may wrap.
    fn counter_of(&self, index: &Expr) -> Option<(usize, i64)> {
        let all = self.scalar(index.ty).range()?;
        let fits = |(low, high): (i128, i128)| low >= all.0 && high <= all.1;
        let moved = |expr: &Expr, by: i128| {
            let (low, high) = self.range(expr);
            let (counter, more) = self.counter_of(expr)?;
            let more = i32::try_from(i128::from(more) + by).ok()?;
            fits((low + by, high + by)).then_some((counter, i64::from(more)))
        };
        match &index.kind {
            ExprKind::Load(place) => {
                let Target::Cell(cell) = self.target(place) else { return None };
                Some((self.counters.iter().rposition(|counter| counter.cell == cell)?, 0))
            }
            ExprKind::Convert(Conversion::Value, operand) => {
                self.program.types.scalar(operand.ty)?.range()?;
                moved(operand, 0)
            }
            ExprKind::Arithmetic(operator, left, right) => {
                match (operator, number(left), number(right)) {
                    (Arithmetic::Add, _, Some(by)) => moved(left, by),
                    (Arithmetic::Add, Some(by), _) => moved(right, by),
                    (Arithmetic::Subtract, _, Some(by)) => moved(left, -by),
                    _ => None,
                }
            }
            _ => None,
        }
    }

    /// A counter times a size.
    fn multiple(&mut self, counter: usize, size: i64) -> Value {
        let counter = &self.counters[counter];
        if let Some((_, product)) = counter.scaled.iter().find(|(scaled, _)| *scaled == size) {
            return self.builder.use_var(*product);
        }
        let value = self.builder.use_var(counter.value);
        self.times(value, size)
    }

    pub(super) fn times(&mut self, at: Value, size: i64) -> Value {
        match size {
            1 => at,
            size if size.count_ones() == 1 => {
                self.builder.ins().ishl_imm_u(at, i64::from(size.trailing_zeros()))
            }
            size => self.builder.ins().imul_imm_s(at, size),
        }
    }

    /// The sizes that the newest counter is multiplied by in `body`, but those that an address has as a factor.
    pub(super) fn scales(&self, body: &hir::Block) -> BTreeSet<i64> {
        let newest = self.counters.len().checked_sub(1);
        let types = &self.program.types;
        let mut sizes = BTreeSet::new();
        walk::places(body, &mut |place, _| {
            let mut ty = self.root_type(place);
            for step in &place.path {
                ty = match (step, types.get(ty)) {
                    (Step::Field(index), Type::Structure(structure)) => {
                        structure.fields[*index as usize].ty
                    }
                    (Step::Index(index), Type::Array { element, .. }) => {
                        let size = i64::from(types.size(*element));
                        let counted = self.counter_of(index).map(|(counter, _)| counter);
                        if counted.is_some() && counted == newest && !FACTORS.contains(&size) {
                            sizes.insert(size);
                        }
                        *element
                    }
                    (Step::OpenIndex(_), Type::OpenArray { element, .. }) => *element,
                    // Behind a bit or a part of a number there is no index.
                    _ => return,
                };
            }
        });
        sizes
    }

    fn root_type(&self, place: &Place) -> TypeId {
        match &place.root {
            Root::Global(id) => self.program.global(*id).ty,
            Root::Local(id) => self.routine.local(*id).ty,
            Root::Instance => self.routine.instance.unwrap_or(place.ty),
            Root::Deref(reference) => match self.program.types.get(reference.ty) {
                Type::Reference { target } => *target,
                _ => place.ty,
            },
        }
    }

    /// An index as a number of 64 bits. One of ULINT that is beyond 2^63 becomes negative.
    pub(super) fn wide_index(&mut self, index: &Expr) -> Value {
        if let Some((counter, more)) = self.counter_of(index) {
            let value = self.builder.use_var(self.counters[counter].value);
            return self.builder.ins().iadd_imm_s(value, more);
        }
        let value = self.expr(index);
        let ty = self.scalar(index.ty);
        // A value that is known not to be negative is extended with zeros, which costs nothing on x86-64.
        let signed = ty.class() == Class::Signed && self.range(index).0 < 0;
        self.widen(value, ty, signed)
    }

    pub(super) fn widen(&mut self, value: Value, ty: Elementary, signed: bool) -> Value {
        match (ty.size(), signed) {
            (8, _) => value,
            (_, true) => self.builder.ins().sextend(types::I64, value),
            (_, false) => self.builder.ins().uextend(types::I64, value),
        }
    }

    /// The number of an element of an open array, counted from its first one.
    pub(super) fn open_index(&mut self, place: &Place, indices: &[Expr]) -> Value {
        let Root::Local(id) = &place.root else { unreachable!("an open array is a parameter") };
        let Home::Open(_, bounds) = self.homes[id.0 as usize].clone() else {
            unreachable!("an open array is a VAR_IN_OUT")
        };
        let mut at = None;
        for (index, (lower, upper)) in indices.iter().zip(bounds) {
            let value = self.wide_index(index);
            if self.range(index).1 > i128::from(i64::MAX) {
                let beyond = self.builder.ins().icmp_imm_s(IntCC::SignedLessThan, value, 0);
                self.trap_if(beyond, TrapKind::Bounds, index.location);
            }
            let (lower, upper) = (self.builder.use_var(lower), self.builder.use_var(upper));
            let from_zero = self.builder.ins().isub(value, lower);
            let last = self.builder.ins().isub(upper, lower);
            let beyond = self.builder.ins().icmp(IntCC::UnsignedGreaterThan, from_zero, last);
            self.trap_if(beyond, TrapKind::Bounds, index.location);
            at = Some(match at {
                None => from_zero,
                Some(outer) => {
                    let count = self.builder.ins().iadd_imm_s(last, 1);
                    let row = self.builder.ins().imul(outer, count);
                    self.builder.ins().iadd(row, from_zero)
                }
            });
        }
        at.unwrap_or_else(|| unreachable!("an array has a dimension"))
    }
}
