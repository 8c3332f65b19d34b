//! One routine: from the typed tree to the intermediate form of Cranelift.
//!
//! Where variables are, in this order of preference:
//! 1. A scalar local whose address never leaves the routine is a value of Cranelift's.
//! 2. A scalar anywhere else is one during a loop in which nothing else can see it ([`super::alias`]): it is read
//!    before the loop and written back behind it, if the loop assigns it.
//! 3. All else is in memory.

use std::collections::HashMap;

use cranelift_codegen::ir::{
    self, Block, DebugTag, FuncRef, Function, InstBuilder, SourceLoc, StackSlot, UserFuncName,
    Value, types,
};
use cranelift_frontend::{FunctionBuilder, FunctionBuilderContext, Variable};

use super::alias::Knowledge;
use super::count::Counter;
use super::effects::{Base, Cell, Target, target};
use super::function::signature;
use super::target::{MEMORY, register};
use super::trap::trap_code;
use super::worst::Loop;
use crate::hir::{Location, Place, Program, Routine, RoutineId, TrapKind};

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
    /// Bytes of the slots in its frame. If they are more than any task has, the function must not be compiled: its slots
    /// are not as large as what lies in them.
    pub slot_bytes: u64,
    /// Its loops; the numbers of their marks are indices of this list.
    pub loops: Vec<Loop>,
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
    /// Whether anything goes to `next`.
    pub continued: bool,
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
    /// The counters of the FOR loops around, the outermost first.
    pub counters: Vec<Counter>,
    pub return_block: Block,
    pub functions: HashMap<(u32, u32), FuncRef>,
    pub constants: Vec<Vec<u8>>,
    pub slot_bytes: u64,
    marked: Vec<Loop>,
    locations: Vec<Location>,
    known_locations: HashMap<Location, u32>,
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
        counters: Vec::new(),
        return_block: Block::from_u32(0),
        functions: HashMap::new(),
        constants: Vec::new(),
        slot_bytes: 0,
        marked: Vec::new(),
        locations: Vec::new(),
        known_locations: HashMap::new(),
    };
    lower.routine();
    let Lower { builder, constants, slot_bytes, locations, marked, .. } = lower;
    builder.finalize(frontend);
    Lowered { function, constants, locations, slot_bytes, loops: marked }
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

    pub(super) fn new_variable(&mut self, ty: ir::Type, value: Value) -> Variable {
        let variable = self.builder.declare_var(ty);
        self.builder.def_var(variable, value);
        variable
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

    /// Marks what follows as a part of a loop, in no loop within it. The mark is no instruction.
    pub(super) fn mark_loop(&mut self, rounds: Option<u64>, location: Location) {
        let number = self.marked.len() as u32;
        self.marked.push(Loop { rounds, location });
        let mark = self.builder.ins().sequence_point();
        self.builder.func.debug_tags.set(mark, [DebugTag::User(number)]);
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
