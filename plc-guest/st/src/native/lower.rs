//! One routine: from the typed tree to the intermediate form of Cranelift.
//!
//! Where variables are, in this order of preference:
//! 1. A scalar local whose address never leaves the routine is a value of Cranelift's.
//! 2. A scalar anywhere else is one during a loop in which nothing else can see it ([`super::alias`]): it is read before the
//!    loop and written back behind it, if the loop assigns it.
//! 3. All else is in memory.

use std::collections::{HashMap, HashSet};

use cranelift_codegen::ir::{
    self, AbiParam, Block, ExtFuncData, ExternalName, FuncRef, Function, InstBuilder, Signature,
    SourceLoc, StackSlot, StackSlotData, StackSlotKind, TrapCode, UserExternalName, UserFuncName,
    Value, types,
};
use cranelift_codegen::isa::CallConv;
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext, Variable};

use super::alias::Knowledge;
use super::effects::{Base, Cell, Target, target};
use super::runtime;
use super::target::{MEMORY, register};
use super::walk;
use crate::hir::{
    Constant, LocalId, LocalKind, Location, Place, Program, Root, Routine, RoutineId, TrapKind,
    Type, TypeId,
};

/// External names of this namespace are routines of the program.
pub const ROUTINES: u32 = 0;
/// Functions of the runtime.
pub const RUNTIME: u32 = 1;
/// Constants of this routine: indices of [`Lowered::constants`].
pub const CONSTANTS: u32 = 2;

/// A routine in Cranelift's form, with what it refers to.
pub struct Lowered {
    /// The function.
    pub function: Function,
    /// Bytes that lie in the constants.
    pub constants: Vec<Vec<u8>>,
    /// Source locations of Cranelift are indices of this list, from 1.
    pub locations: Vec<Location>,
}

/// Where a local variable is.
#[derive(Clone)]
pub(super) enum Home {
    /// In a value of Cranelift's.
    Register(Variable),
    /// In the frame.
    Slot(StackSlot),
    /// Behind an address that the caller gave.
    Pointer(Variable),
    /// Behind an address that the caller gave, with lower and upper bound of each dimension.
    Open(Variable, Vec<(Variable, Variable)>),
}

/// A variable that lives in a register during a loop.
pub(super) struct Promoted {
    pub cell: Cell,
    pub variable: Variable,
}

/// Where EXIT and CONTINUE go.
pub(super) struct LoopBlocks {
    pub next: Block,
    pub exit: Block,
}

/// The state of the lowering of one routine.
pub(super) struct Lower<'a> {
    pub program: &'a Program,
    pub knowledge: &'a Knowledge,
    pub routine: &'a Routine,
    pub builder: FunctionBuilder<'a>,
    pub homes: Vec<Home>,
    pub instance: Option<Variable>,
    pub promoted: Vec<Promoted>,
    /// Cells of the promoted that must be written back if the routine returns from within their loop.
    pub written: Vec<(Cell, Variable)>,
    pub ranges: HashMap<Cell, (i128, i128)>,
    pub loops: Vec<LoopBlocks>,
    pub return_block: Block,
    functions: HashMap<(u32, u32), FuncRef>,
    pub constants: Vec<Vec<u8>>,
    locations: Vec<Location>,
    known_locations: HashMap<Location, u32>,
}

/// The signature of a routine: instance, address of a result that is not a scalar, parameters.
pub fn signature(program: &Program, routine: &Routine) -> Signature {
    let mut signature = Signature::new(CallConv::SystemV);
    let mut push = |ty| signature.params.push(AbiParam::new(ty));
    if routine.instance.is_some() {
        push(types::I64);
    }
    let result = routine.result.map(|id| program.types.scalar(routine.local(id).ty));
    if result == Some(None) {
        push(types::I64);
    }
    for (_, local) in routine.parameters() {
        match (local.kind, program.types.scalar(local.ty), program.types.get(local.ty)) {
            (LocalKind::Input, Some(scalar), _) => push(register(scalar)),
            (_, _, Type::OpenArray { dimensions, .. }) => {
                for _ in 0..1 + 2 * dimensions {
                    push(types::I64);
                }
            }
            _ => push(types::I64),
        }
    }
    if let Some(Some(scalar)) = result {
        signature.returns.push(AbiParam::new(register(scalar)));
    }
    signature
}

/// The trap code of a kind, and back.
pub fn trap_code(kind: TrapKind) -> TrapCode {
    TrapCode::unwrap_user(match kind {
        TrapKind::Bounds => 1,
        TrapKind::ZeroDivide => 2,
        TrapKind::Null => 3,
        TrapKind::LoopBudget => 4,
        TrapKind::Subrange => 5,
    })
}

/// The kind that a trap code stands for.
pub fn trap_kind(code: TrapCode) -> Option<TrapKind> {
    let all = [
        TrapKind::Bounds,
        TrapKind::ZeroDivide,
        TrapKind::Null,
        TrapKind::LoopBudget,
        TrapKind::Subrange,
    ];
    all.into_iter().find(|kind| trap_code(*kind) == code)
}

/// Lowers routine `id`.
pub fn lower(
    program: &Program,
    knowledge: &Knowledge,
    id: RoutineId,
    context: &mut FunctionBuilderContext,
    frontend: cranelift_codegen::isa::TargetFrontendConfig,
) -> Lowered {
    let routine = program.routine(id);
    let name = UserFuncName::user(ROUTINES, id.0);
    let mut function = Function::with_name_signature(name, signature(program, routine));
    // Cranelift keeps locations as distances from the first one that is used, and the distance -1
    // means none: so the base must be the least.
    function.params.ensure_base_srcloc(SourceLoc::new(1));
    let builder = FunctionBuilder::new(&mut function, context);
    let mut lower = Lower {
        program,
        knowledge,
        routine,
        builder,
        homes: Vec::new(),
        instance: None,
        promoted: Vec::new(),
        written: Vec::new(),
        ranges: HashMap::new(),
        loops: Vec::new(),
        return_block: Block::from_u32(0),
        functions: HashMap::new(),
        constants: Vec::new(),
        locations: Vec::new(),
        known_locations: HashMap::new(),
    };
    lower.routine();
    let Lower { builder, constants, locations, .. } = lower;
    builder.finalize(frontend);
    Lowered { function, constants, locations }
}

impl<'a> Lower<'a> {
    fn routine(&mut self) {
        let entry = self.builder.create_block();
        self.return_block = self.builder.create_block();
        self.builder.append_block_params_for_function_params(entry);
        self.builder.switch_to_block(entry);
        self.at(self.routine.location);
        let parameters = self.builder.block_params(entry).to_vec();
        let outputs = self.receive(&mut parameters.into_iter());
        self.initialise();
        self.block(&self.routine.body);
        self.builder.ins().jump(self.return_block, &[]);
        self.builder.switch_to_block(self.return_block);
        for (id, address) in outputs {
            let ty = self.routine.local(id).ty;
            let address = self.builder.use_var(address);
            self.copy_out(id, ty, address);
        }
        let result = self.routine.result.and_then(|id| match &self.homes[id.0 as usize] {
            Home::Register(variable) => Some(self.builder.use_var(*variable)),
            Home::Slot(slot) => {
                let scalar = self.program.types.scalar(self.routine.local(id).ty)?;
                let address = self.builder.ins().stack_addr(types::I64, *slot, 0);
                Some(self.builder.ins().load(register(scalar), MEMORY, address, 0))
            }
            _ => None,
        });
        self.builder.ins().return_(result.as_slice());
        self.builder.seal_all_blocks();
    }

    /// Gives each local its home. Returns where each output goes.
    fn receive(&mut self, values: &mut impl Iterator<Item = Value>) -> Vec<(LocalId, Variable)> {
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
    fn initialise(&mut self) {
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

    fn initialise_memory(&mut self, address: Value, ty: TypeId, initial: &Constant) {
        if self.program.types.is_string(ty) && matches!(initial, Constant::Default) {
            // Two bytes end a WSTRING; the second is there in a STRING of any capacity but 0.
            let ty = if self.program.types.size(ty) > 1 { types::I16 } else { types::I8 };
            let zero = self.builder.ins().iconst(ty, 0);
            self.builder.ins().store(MEMORY, zero, address, 0);
            return;
        }
        let mut bytes = vec![0; self.program.types.size(ty) as usize];
        self.program
            .types
            .encode(ty, initial, &mut bytes, &|id| super::global_address(self.program, id));
        let size = bytes.len() as u32;
        if bytes.iter().all(|byte| *byte == 0) {
            self.zero(address, size);
        } else {
            let from = self.constant_address(bytes);
            self.copy(address, from, size);
        }
    }

    fn copy_out(&mut self, id: LocalId, ty: TypeId, to: Value) {
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

    pub(super) fn new_variable(&mut self, ty: ir::Type, value: Value) -> Variable {
        let variable = self.builder.declare_var(ty);
        self.builder.def_var(variable, value);
        variable
    }

    pub(super) fn slot(&mut self, size: u32, align: u32) -> StackSlot {
        let shift = align.max(1).trailing_zeros() as u8;
        self.builder.create_sized_stack_slot(StackSlotData::new(
            StackSlotKind::ExplicitSlot,
            size.max(1),
            shift,
        ))
    }

    /// What follows is at `location` of the source.
    pub(super) fn at(&mut self, location: Location) {
        let next = self.locations.len() as u32 + 1;
        let index = *self.known_locations.entry(location).or_insert(next);
        if index == next {
            self.locations.push(location);
        }
        self.builder.set_srcloc(SourceLoc::new(index));
    }

    /// Traps if `condition` is not 0.
    pub(super) fn trap_if(&mut self, condition: Value, kind: TrapKind, location: Location) {
        let before = self.builder.srcloc();
        self.at(location);
        self.builder.ins().trapnz(condition, trap_code(kind));
        self.builder.set_srcloc(before);
    }

    pub(super) fn function(
        &mut self,
        namespace: u32,
        index: u32,
        signature: impl FnOnce() -> Signature,
    ) -> FuncRef {
        if let Some(function) = self.functions.get(&(namespace, index)) {
            return *function;
        }
        let name =
            self.builder.func.declare_imported_user_function(UserExternalName { namespace, index });
        let signature = self.builder.import_signature(signature());
        let data = ExtFuncData {
            name: ExternalName::user(name),
            signature,
            colocated: true,
            patchable: false,
        };
        let function = self.builder.import_function(data);
        self.functions.insert((namespace, index), function);
        function
    }

    /// Calls a function of the runtime.
    pub(super) fn runtime(
        &mut self,
        function: runtime::Function,
        arguments: &[Value],
        result: Option<ir::Type>,
    ) -> Option<Value> {
        let parameters: Vec<ir::Type> =
            arguments.iter().map(|value| self.builder.func.dfg.value_type(*value)).collect();
        let callee = self.function(RUNTIME, function as u32, || {
            let mut signature = Signature::new(CallConv::SystemV);
            signature.params.extend(parameters.into_iter().map(AbiParam::new));
            signature.returns.extend(result.map(AbiParam::new));
            signature
        });
        let call = self.builder.ins().call(callee, arguments);
        self.builder.inst_results(call).first().copied()
    }

    /// The address of bytes that lie in the constants.
    pub(super) fn constant_address(&mut self, bytes: Vec<u8>) -> Value {
        let index = self.constants.len() as u32;
        self.constants.push(bytes);
        let name = self
            .builder
            .func
            .declare_imported_user_function(UserExternalName { namespace: CONSTANTS, index });
        let global = self.builder.create_global_value(ir::GlobalValueData::Symbol {
            name: ExternalName::user(name),
            offset: 0.into(),
            colocated: true,
            tls: false,
        });
        self.builder.ins().symbol_value(types::I64, global)
    }

    /// Sets memory to zero.
    pub(super) fn zero(&mut self, to: Value, size: u32) {
        if size > 64 {
            let bytes = self.builder.ins().iconst(types::I64, i64::from(size));
            self.runtime(runtime::Function::Zero, &[to, bytes], None);
            return;
        }
        for (offset, ty) in words(size) {
            let zero = self.builder.ins().iconst(ty, 0);
            self.builder.ins().store(MEMORY, zero, to, offset);
        }
    }

    /// Copies memory; the two may be the same or overlap.
    pub(super) fn copy(&mut self, to: Value, from: Value, size: u32) {
        if size > 64 {
            let bytes = self.builder.ins().iconst(types::I64, i64::from(size));
            self.runtime(runtime::Function::Copy, &[to, from, bytes], None);
            return;
        }
        let loaded: Vec<(i32, Value)> = words(size)
            .map(|(offset, ty)| (offset, self.builder.ins().load(ty, MEMORY, from, offset)))
            .collect();
        for (offset, value) in loaded {
            self.builder.ins().store(MEMORY, value, to, offset);
        }
    }

    /// The variable that holds the cell in this part of the routine.
    pub(super) fn register_of(&self, cell: &Cell) -> Option<Variable> {
        if let Base::Local(id) = cell.base
            && let Home::Register(variable) = &self.homes[id.0 as usize]
        {
            return Some(*variable);
        }
        self.promoted
            .iter()
            .rev()
            .find(|promoted| promoted.cell == *cell)
            .map(|promoted| promoted.variable)
    }

    pub(super) fn target(&self, place: &Place) -> Target {
        target(self.program, self.routine, place)
    }
}

/// The machine words that make up `size` bytes.
fn words(size: u32) -> impl Iterator<Item = (i32, ir::Type)> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let ty = match size - at {
            0 => return None,
            1 => types::I8,
            2..=3 => types::I16,
            4..=7 => types::I32,
            _ => types::I64,
        };
        let offset = at as i32;
        at += ty.bytes();
        Some((offset, ty))
    })
}
