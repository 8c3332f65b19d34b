//! The homes of a routine's variables, and what they begin with.

use std::collections::HashSet;

use cranelift_codegen::ir::{InstBuilder, StackSlot, StackSlotData, StackSlotKind, Value, types};
use cranelift_frontend::Variable;
use takt_program::limit::STACK_BYTES;

use super::effects::{Target, target};
use super::lower::{Home, Lower};
use super::target::{MEMORY, register};
use super::walk;
use crate::hir::{Constant, LocalId, LocalKind, Root, Type, TypeId};

impl Lower<'_> {
    /// Gives each local its home. Returns where each output goes.
    pub(super) fn receive(
        &mut self,
        values: &mut impl Iterator<Item = Value>,
    ) -> Vec<(LocalId, Variable)> {
        let routine = self.routine;
        let mut exposed = HashSet::new();
        walk::places(&routine.body, &mut |place, leaves| {
            let partial = matches!(target(self.program, routine, place), Target::Range { .. });
            if let (Root::Local(id), true) = (&place.root, leaves || partial) {
                exposed.insert(*id);
            }
        });
        let mut next = || {
            values
                .next()
                .unwrap_or_else(|| unreachable!("the signature is made of the same locals"))
        };
        if routine.instance.is_some() {
            let address = next();
            self.instance = Some(self.new_variable(types::I64, address));
        }
        let result_at = match routine.result {
            Some(id) if self.program.types.scalar(routine.local(id).ty).is_none() => {
                Some((id, next()))
            }
            _ => None,
        };
        let mut outputs = Vec::new();
        for (index, local) in routine.locals.iter().enumerate() {
            let id = LocalId(index as u32);
            let scalar = self.program.types.scalar(local.ty);
            let home = match (local.kind, self.program.types.get(local.ty)) {
                (LocalKind::InOut, Type::OpenArray { dimensions, .. }) => {
                    let dimensions = *dimensions;
                    let address = next();
                    let address = self.new_variable(types::I64, address);
                    let bounds = (0..dimensions).map(|_| {
                        let (lower, upper) = (next(), next());
                        (self.new_variable(types::I64, lower), self.new_variable(types::I64, upper))
                    });
                    Home::Open(address, bounds.collect())
                }
                (LocalKind::InOut, _) => {
                    let address = next();
                    Home::Pointer(self.new_variable(types::I64, address))
                }
                (LocalKind::Input, _) => {
                    let value = next();
                    match scalar {
                        Some(scalar) if exposed.contains(&id) => {
                            let slot = self.slot(scalar.size(), scalar.size());
                            let address = self.builder.ins().stack_addr(types::I64, slot, 0);
                            self.builder.ins().store(MEMORY, value, address, 0);
                            Home::Slot(slot)
                        }
                        Some(scalar) => Home::Register(self.new_variable(register(scalar), value)),
                        // The caller made the copy.
                        None => Home::Pointer(self.new_variable(types::I64, value)),
                    }
                }
                (LocalKind::Output | LocalKind::Variable, _) => {
                    if local.kind == LocalKind::Output {
                        let address = next();
                        outputs.push((id, self.new_variable(types::I64, address)));
                    }
                    match (scalar, result_at) {
                        (Some(scalar), _) if !exposed.contains(&id) => {
                            Home::Register(self.builder.declare_var(register(scalar)))
                        }
                        (None, Some((result, address))) if result == id => {
                            Home::Pointer(self.new_variable(types::I64, address))
                        }
                        _ => {
                            let (size, align) = (
                                self.program.types.size(local.ty),
                                self.program.types.align(local.ty),
                            );
                            Home::Slot(self.slot(size, align))
                        }
                    }
                }
            };
            self.homes.push(home);
        }
        outputs
    }

    /// Gives variables and outputs their initial values.
    pub(super) fn initialise(&mut self) {
        // Such a routine is refused, and its initial values may be gigabytes.
        if self.is_too_large() {
            return;
        }
        let routine = self.routine;
        for (index, local) in routine.locals.iter().enumerate() {
            if !matches!(local.kind, LocalKind::Variable | LocalKind::Output) {
                continue;
            }
            let home = self.homes[index].clone();
            match home {
                Home::Register(variable) => {
                    let value = self.constant(local.ty, &local.initial);
                    self.builder.def_var(variable, value);
                }
                Home::Slot(slot) => {
                    let address = self.builder.ins().stack_addr(types::I64, slot, 0);
                    self.initialise_memory(address, local.ty, &local.initial);
                }
                Home::Pointer(address) => {
                    let address = self.builder.use_var(address);
                    self.initialise_memory(address, local.ty, &local.initial);
                }
                Home::Open(..) => unreachable!("an open array is a VAR_IN_OUT"),
            }
        }
    }

    fn is_too_large(&self) -> bool {
        self.slot_bytes > u64::from(STACK_BYTES)
    }

    fn initialise_memory(&mut self, address: Value, ty: TypeId, initial: &Constant) {
        if self.program.types.is_string(ty) && matches!(initial, Constant::Default) {
            // Two bytes end a WSTRING; the second is there in a STRING of any capacity but 0.
            let ty = if self.program.types.size(ty) > 1 { types::I16 } else { types::I8 };
            let zero = self.builder.ins().iconst(ty, 0);
            self.builder.ins().store(MEMORY, zero, address, 0);
            return;
        }
        let mut bytes = vec![0; self.program.types.size(ty) as usize];
        self.program.types.encode(ty, initial, &mut bytes, &|id, fields| {
            super::field_address(self.program, id, fields)
        });
        let size = bytes.len() as u32;
        if bytes.iter().all(|byte| *byte == 0) {
            self.zero(address, size);
        } else {
            let from = self.constant_address(bytes);
            self.copy(address, from, size);
        }
    }

    pub(super) fn copy_out(&mut self, id: LocalId, ty: TypeId, to: Value) {
        match self.homes[id.0 as usize].clone() {
            Home::Register(variable) => {
                let value = self.builder.use_var(variable);
                self.builder.ins().store(MEMORY, value, to, 0);
            }
            Home::Slot(slot) => {
                let from = self.builder.ins().stack_addr(types::I64, slot, 0);
                self.copy(to, from, self.program.types.size(ty));
            }
            Home::Pointer(_) | Home::Open(..) => unreachable!("an output is a variable"),
        }
    }

    /// Room in the frame. Behind the limit it is made no larger: Cranelift computes the places of the slots in 32 bits.
    pub(super) fn slot(&mut self, size: u32, align: u32) -> StackSlot {
        let shift = align.max(1).trailing_zeros() as u8;
        let start = self.slot_bytes.next_multiple_of(u64::from(align.max(8)));
        self.slot_bytes = start + u64::from(size.max(1));
        let size = if self.is_too_large() { 1 } else { size };
        self.builder.create_sized_stack_slot(StackSlotData::new(
            StackSlotKind::ExplicitSlot,
            size.max(1),
            shift,
        ))
    }
}
