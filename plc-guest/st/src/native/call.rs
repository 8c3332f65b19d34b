//! Calls: functions, function blocks and programs.

use cranelift_codegen::ir::{InstBuilder, Value, types};

use super::function::signature;
use super::lower::{Home, Lower, ROUTINES};
use super::place::Located;
use super::target::{MEMORY, register};
use crate::hir::{Argument, LocalKind, Place, Root, RoutineId, Type, TypeId};

/// An output that is assigned after the call.
struct Pending {
    to: Located,
    from: Value,
    ty: TypeId,
}

impl Lower<'_> {
    pub(super) fn invoke(&mut self, place: &Place, routine: RoutineId, arguments: &[Argument]) {
        let instance = self.address(place);
        self.call_with(routine, arguments, Some(instance));
    }

    /// Calls a function whose result, if any, is a scalar.
    pub(super) fn call(&mut self, routine: RoutineId, arguments: &[Argument]) -> Option<Value> {
        self.call_with(routine, arguments, None)
    }

    /// Calls a function whose result is not a scalar. Returns the address of the result, in this frame.
    pub(super) fn call_into_temporary(
        &mut self,
        routine: RoutineId,
        arguments: &[Argument],
    ) -> Value {
        let callee = self.program.routine(routine);
        let ty = match callee.result {
            Some(id) => callee.local(id).ty,
            None => unreachable!("a function with a result is called"),
        };
        let slot = self.slot(self.program.types.size(ty), self.program.types.align(ty));
        let address = self.builder.ins().stack_addr(types::I64, slot, 0);
        self.call_with(routine, arguments, Some(address));
        self.builder.ins().stack_addr(types::I64, slot, 0)
    }

    /// Calls a routine with its arguments behind `first`: the address of the instance, or of a result that is no scalar.
    fn call_with(
        &mut self,
        routine: RoutineId,
        arguments: &[Argument],
        first: Option<Value>,
    ) -> Option<Value> {
        let callee = self.program.routine(routine);
        let mut values: Vec<Value> = first.into_iter().collect();
        let mut pending = Vec::new();
        for ((_, parameter), argument) in callee.parameters().zip(arguments) {
            let ty = parameter.ty;
            match (parameter.kind, argument) {
                (LocalKind::Input, Argument::Value(value)) => {
                    let passed = if self.program.types.scalar(ty).is_some() {
                        self.expr(value)
                    } else if self.program.types.is_string(ty) {
                        self.text_temporary(value, ty)
                    } else {
                        let from = self.aggregate(value);
                        let to = self.temporary(ty);
                        self.copy(to, from, self.program.types.size(ty));
                        to
                    };
                    values.push(passed);
                }
                (LocalKind::InOut, Argument::Reference(place)) => {
                    self.reference(place, ty, &mut values)
                }
                (LocalKind::Output, Argument::Output(place)) => {
                    let from = self.temporary(ty);
                    values.push(from);
                    if let Some(place) = place {
                        let to = self.locate(place);
                        pending.push(Pending { to, from, ty });
                    }
                }
                (kind, argument) => {
                    unreachable!("parameter {} is {kind:?}, given {argument:?}", parameter.name)
                }
            }
        }
        let returned = self.emit_call(routine, &values);
        for Pending { to, from, ty } in pending {
            match (self.program.types.scalar(ty), to) {
                (Some(scalar), to) => {
                    let value = self.builder.ins().load(register(scalar), MEMORY, from, 0);
                    self.store(to, value);
                }
                (None, Located::Memory(base, offset)) => {
                    let to = self.builder.ins().iadd_imm_s(base, i64::from(offset));
                    self.copy(to, from, self.program.types.size(ty));
                }
                (None, _) => unreachable!("what is no scalar is in memory"),
            }
        }
        returned
    }

    pub(super) fn temporary(&mut self, ty: TypeId) -> Value {
        let slot = self.slot(self.program.types.size(ty), self.program.types.align(ty));
        self.builder.ins().stack_addr(types::I64, slot, 0)
    }

    /// Passes a place for a VAR_IN_OUT of type `parameter`.
    fn reference(&mut self, place: &Place, parameter: TypeId, values: &mut Vec<Value>) {
        let address = self.address(place);
        values.push(address);
        let Type::OpenArray { dimensions, .. } = self.program.types.get(parameter) else { return };
        if let (Type::OpenArray { .. }, Root::Local(id)) =
            (self.program.types.get(place.ty), &place.root)
            && let Home::Open(_, bounds) = self.homes[id.0 as usize].clone()
        {
            for (lower, upper) in bounds {
                values.push(self.builder.use_var(lower));
                values.push(self.builder.use_var(upper));
            }
            return;
        }
        let mut ty = place.ty;
        for _ in 0..*dimensions {
            let Type::Array { element, lower, upper } = *self.program.types.get(ty) else {
                unreachable!("an array of as many dimensions is passed")
            };
            values.push(self.builder.ins().iconst(types::I64, lower));
            values.push(self.builder.ins().iconst(types::I64, upper));
            ty = element;
        }
    }

    fn emit_call(&mut self, routine: RoutineId, values: &[Value]) -> Option<Value> {
        let program = self.program;
        let callee =
            self.function(ROUTINES, routine.0, || signature(program, program.routine(routine)));
        let call = self.builder.ins().call(callee, values);
        self.builder.inst_results(call).first().copied()
    }
}
