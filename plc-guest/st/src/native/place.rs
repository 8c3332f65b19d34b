//! Places: addresses, loads and stores.

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{AtomicRmwOp, InstBuilder, InstructionData, Opcode, Value, types};
use cranelift_frontend::Variable;

use super::effects::{Base, Cell, Target};
use super::index::{Distance, Term};
use super::lower::{Home, Lower};
use super::target::{MEMORY, register};
use crate::hir::{Area, Elementary, Place, Root, Step, TrapKind, Type, TypeId};

/// A place whose path has been evaluated.
#[derive(Clone, Copy)]
pub(super) enum Located {
    /// In a register.
    Register(Variable),
    /// At an address and an offset from it.
    Memory(Value, i32),
    /// A bit of the byte at an address and an offset, and whether another task may use the byte.
    Bit(Value, i32, u8, bool),
}

impl Lower<'_> {
    /// Evaluates the path of a place.
    pub(super) fn locate(&mut self, place: &Place) -> Located {
        if let Target::Cell(cell) = self.target(place)
            && let Some(variable) = self.register_of(&cell)
        {
            return Located::Register(variable);
        }
        self.locate_in_memory(place)
    }

    /// The same of what a variable has in memory, even if it lives in a register now.
    fn locate_in_memory(&mut self, place: &Place) -> Located {
        let types = &self.program.types;
        let mut bit = None;
        let (mut base, mut offset, mut ty) = self.root(place, &mut bit);
        let (mut terms, mut character) = (Vec::new(), None);
        for step in &place.path {
            match (step, types.get(ty)) {
                (Step::Field(index), Type::Structure(structure)) => {
                    let field = &structure.fields[*index as usize];
                    offset += i64::from(field.offset);
                    ty = field.ty;
                }
                (Step::Index(index), Type::Array { element, lower, upper }) => {
                    let size = i64::from(types.size(*element));
                    ty = *element;
                    match self.index(index, (*lower, *upper), size) {
                        Distance::Constant(distance) => offset += distance,
                        Distance::Term(term) => terms.push(term),
                        Distance::From(term, distance) => {
                            terms.push(term);
                            offset += distance;
                        }
                    }
                }
                (Step::OpenIndex(indices), Type::OpenArray { element, .. }) => {
                    let size = i64::from(types.size(*element));
                    ty = *element;
                    let at = self.open_index(place, indices);
                    terms.push(Term { changes: usize::MAX, value: self.times(at, size) });
                }
                (Step::Unit(position), _) => character = Some((position, ty)),
                (Step::Bit(number), _) => {
                    offset += i64::from(number / 8);
                    bit = Some(number % 8);
                }
                (Step::Part { offset: part, ty: part_type }, _) => {
                    offset += i64::from(*part);
                    ty = *part_type;
                }
                (step, ty) => unreachable!("{step:?} of {ty:?}"),
            }
        }
        // What changes in an outer loop first: inner loops find that part of the sum done.
        terms.sort_by_key(|term: &Term| term.changes);
        for term in terms {
            base = self.builder.ins().iadd(base, term.value);
        }
        let (base, offset) = match i32::try_from(offset) {
            Ok(offset) => (base, offset),
            Err(_) => (self.builder.ins().iadd_imm_s(base, offset), 0),
        };
        if let Some((position, text)) = character {
            return Located::Memory(self.character(base, offset, text, position), 0);
        }
        match bit {
            None => Located::Memory(base, offset),
            Some(bit) => Located::Bit(base, offset, bit, self.is_shared(place)),
        }
    }

    fn root(&mut self, place: &Place, bit: &mut Option<u8>) -> (Value, i64, TypeId) {
        match &place.root {
            Root::Global(id) => {
                let global = self.program.global(*id);
                *bit = global.storage.bit;
                // One constant for each area, so that the accesses of a routine share it.
                let area = super::area_address(global.storage.area);
                let base = self.builder.ins().iconst(types::I64, area as i64);
                (base, i64::from(global.storage.offset), global.ty)
            }
            Root::Local(id) => {
                let ty = self.routine.local(*id).ty;
                let base = match self.homes[id.0 as usize].clone() {
                    Home::Slot(slot) => self.builder.ins().stack_addr(types::I64, slot, 0),
                    Home::Pointer(address) | Home::Open(address, _) => {
                        self.builder.use_var(address)
                    }
                    Home::Register(_) => {
                        unreachable!("a local whose address is taken is in memory")
                    }
                };
                (base, 0, ty)
            }
            Root::Instance => {
                let address =
                    self.instance.unwrap_or_else(|| unreachable!("the routine has an instance"));
                (self.builder.use_var(address), 0, self.routine.instance.unwrap_or(place.ty))
            }
            Root::Deref(reference) => {
                let address = self.expr(reference);
                let null = self.builder.ins().icmp_imm_s(IntCC::Equal, address, 0);
                self.trap_if(null, TrapKind::Null, reference.location);
                let Type::Reference { target } = self.program.types.get(reference.ty) else {
                    unreachable!("a reference is dereferenced")
                };
                (address, 0, *target)
            }
        }
    }

    /// The address of a place. A variable may live in a register meanwhile: then nothing uses the address until it
    /// has been written back.
    pub(super) fn address(&mut self, place: &Place) -> Value {
        match self.locate_in_memory(place) {
            Located::Memory(base, 0) => base,
            Located::Memory(base, offset) => self.builder.ins().iadd_imm_s(base, i64::from(offset)),
            Located::Register(_) | Located::Bit(..) => {
                unreachable!("a place without an address is referred to")
            }
        }
    }

    pub(super) fn scalar(&self, ty: TypeId) -> Elementary {
        self.program
            .types
            .scalar(ty)
            .unwrap_or_else(|| unreachable!("a value in a register is a scalar"))
    }

    /// The value at a place of a scalar type.
    pub(super) fn load(&mut self, located: Located, ty: TypeId) -> Value {
        match located {
            Located::Register(variable) => self.builder.use_var(variable),
            Located::Memory(base, offset) => {
                let scalar = self.scalar(ty);
                self.builder.ins().load(register(scalar), MEMORY, base, offset)
            }
            Located::Bit(base, offset, bit, _) => {
                let byte = self.builder.ins().load(types::I8, MEMORY, base, offset);
                let low = self.builder.ins().ushr_imm_u(byte, i64::from(bit));
                self.builder.ins().band_imm_u(low, 1)
            }
        }
    }

    /// Assigns a scalar.
    pub(super) fn store(&mut self, located: Located, value: Value) {
        match located {
            Located::Register(variable) => self.builder.def_var(variable, value),
            Located::Memory(base, offset) => {
                self.builder.ins().store(MEMORY, value, base, offset);
            }
            Located::Bit(base, offset, bit, true) => {
                let address = self.builder.ins().iadd_imm_s(base, i64::from(offset));
                self.store_shared_bit(address, bit, value);
            }
            Located::Bit(base, offset, bit, false) => {
                let byte = self.builder.ins().load(types::I8, MEMORY, base, offset);
                let others = self.builder.ins().band_imm_u(byte, i64::from(!(1u8 << bit)));
                let mine = self.builder.ins().ishl_imm_u(value, i64::from(bit));
                let byte = self.builder.ins().bor(others, mine);
                self.builder.ins().store(MEMORY, byte, base, offset);
            }
        }
    }

    /// Assigns a bit so that a task in between loses no assignment of a bit beside it, and sees this one before or behind
    /// it: one instruction sets the bit, or leaves it, and one clears it, or leaves it.
    fn store_shared_bit(&mut self, address: Value, bit: u8, value: Value) {
        let constant = self.known(value);
        let mine = self.builder.ins().ishl_imm_u(value, i64::from(bit));
        if constant != Some(0) {
            self.builder.ins().atomic_rmw(types::I8, MEMORY, AtomicRmwOp::Or, address, mine);
        }
        if constant.is_none_or(|value| value == 0) {
            let kept = self.builder.ins().bor_imm_u(mine, i64::from(!(1u8 << bit)));
            self.builder.ins().atomic_rmw(types::I8, MEMORY, AtomicRmwOp::And, address, kept);
        }
    }

    /// What a value is, if it is a constant.
    fn known(&self, value: Value) -> Option<i64> {
        let instruction = self.builder.func.dfg.value_def(value).inst()?;
        match self.builder.func.dfg.insts[instruction] {
            InstructionData::UnaryImm { opcode: Opcode::Iconst, imm } => Some(imm.bits()),
            _ => None,
        }
    }

    /// Whether another task may use the place. A task has the outputs for itself.
    fn is_shared(&self, place: &Place) -> bool {
        let target = self.target(place);
        let own = matches!(
            target,
            Target::Range { base: Base::Area(Area::Output), .. }
                | Target::Cell(Cell { base: Base::Area(Area::Output), .. })
        );
        !own && self.knowledge.is_shared(self.routine, &target)
    }

    /// The address of a cell, whatever holds it now.
    pub(super) fn cell_address(&mut self, cell: &Cell) -> (Value, i32) {
        let offset = cell.offset as i32;
        let base = match cell.base {
            Base::Area(area) => {
                let area = super::area_address(area);
                self.builder.ins().iconst(types::I64, area as i64)
            }
            Base::Instance => {
                let address =
                    self.instance.unwrap_or_else(|| unreachable!("the routine has an instance"));
                self.builder.use_var(address)
            }
            Base::Local(id) | Base::Pointer(id) => match self.homes[id.0 as usize].clone() {
                Home::Slot(slot) => self.builder.ins().stack_addr(types::I64, slot, 0),
                Home::Pointer(address) | Home::Open(address, _) => self.builder.use_var(address),
                Home::Register(_) => unreachable!("a register has no address"),
            },
        };
        (base, offset)
    }
}
