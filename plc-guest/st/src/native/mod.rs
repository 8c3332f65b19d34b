//! The code generator: from the typed tree to machine code at the addresses of a program.
//!
//! Each routine is lowered to the intermediate form of Cranelift and compiled by it, on its own; then all are placed
//! one behind the other and the distances between them are filled in. There is no object file and no linker: a program
//! has fixed addresses and refers to nothing outside of itself, and two builds of a source are equal to the last bit.

mod alias;
mod arithmetic;
mod call;
mod case;
mod channel;
mod convert;
mod count;
mod effects;
mod expr;
mod frame;
mod function;
mod image;
mod index;
mod link;
mod loops;
mod lower;
mod memory;
mod parallel;
mod place;
mod retained;
mod runtime;
mod start;
mod statement;
mod target;
mod text;
mod trap;
pub(crate) mod walk;
mod worst;
mod writers;

pub use image::image;
pub use worst::{Cost, Worst, worst};

use cranelift_codegen::ir::Function;
use cranelift_codegen::isa::TargetIsa;
use cranelift_codegen::{Context, control::ControlPlane};
use cranelift_frontend::FunctionBuilderContext;
use takt_program::limit::STACK_BYTES;
use thiserror::Error;

use crate::hir::{Area, Constant, GlobalId, Location, Program, RoutineId, Trap};

/// A compiled program.
pub struct Native {
    /// The code, for the address where the code of every program begins.
    pub code: Vec<u8>,
    /// The constants, for the page behind the code.
    pub constants: Vec<u8>,
    /// The initial state: all variables with their initial values.
    pub state: Vec<u8>,
    /// The offset of `init`.
    pub init: u32,
    /// The offset of each routine's code.
    pub routines: Vec<u32>,
    /// Bytes of stack that each task takes at most, in the order of the tasks.
    pub stacks: Vec<u32>,
    /// Instructions that end the program, by their offset, ascending.
    pub traps: Vec<TrapSite>,
    /// Where the code of a place in the source begins, ascending.
    pub lines: Vec<(u32, Location)>,
    /// Which tasks write what.
    writers: writers::Writers,
}

/// An instruction that ends the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrapSite {
    /// Its offset in the code.
    pub offset: u32,
    /// What it means.
    pub trap: Trap,
}

/// Why a program cannot be compiled.
#[derive(Debug, Error)]
pub enum NativeError {
    /// Cranelift refused a routine: an error of the compiler.
    #[error("internal error of the compiler in {routine}: {message}")]
    Internal {
        /// The routine.
        routine: String,
        /// What Cranelift says.
        message: String,
    },
    /// The system has no room for a thread.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// More of something than a program can have.
    #[error("the program has {bytes} bytes of {what}; it may have at most {limit}")]
    TooMuch {
        /// Of what.
        what: &'static str,
        /// How much there is.
        bytes: usize,
        /// How much there may be.
        limit: u32,
        /// What takes most of it.
        most: Most,
    },
    /// A REF of an output, and several tasks that may assign it through one.
    #[error(
        "REF of the output `{output}`, and the tasks `{}` and `{}` both assign through references of its type",
        tasks[0],
        tasks[1]
    )]
    ReferredOutput {
        /// The output.
        output: String,
        /// Where REF stands.
        location: Location,
        /// Two of the tasks.
        tasks: [String; 2],
    },
    /// An output that two tasks write, whole, in part or through another variable at its address.
    #[error(
        "the tasks `{}` and `{}` both write the output `{output}`, or a part of it: it would never leave the program",
        tasks[0],
        tasks[1]
    )]
    SharedOutput {
        /// The output.
        output: String,
        /// Two of the tasks.
        tasks: [String; 2],
        /// Where each of them writes.
        locations: [Location; 2],
    },
    /// More stack than a task can have.
    #[error("{needing} needs {bytes} bytes of stack; a task has at most {STACK_BYTES}")]
    TooMuchStack {
        /// The task, or the routine if no task calls it.
        needing: Box<str>,
        /// Where it is declared.
        location: Location,
        /// What it needs.
        bytes: u64,
        /// The routine that takes most of it itself.
        most: Most,
        /// The largest variable of that routine, with its bytes.
        variable: Option<(String, u32)>,
    },
}

/// What takes most of something.
#[derive(Clone, Debug, Default)]
pub struct Most {
    /// Its name.
    pub name: String,
    /// How many bytes it takes.
    pub bytes: u64,
    /// Where it is declared.
    pub location: Location,
}

/// Compiles a program.
///
/// # Errors
/// See [`NativeError`].
pub fn compile(program: &Program) -> Result<Native, NativeError> {
    if program.state_size() > takt_program::limit::STATE_BYTES {
        return Err(NativeError::TooMuch {
            what: "variables",
            bytes: program.state_size() as usize,
            limit: takt_program::limit::STATE_BYTES,
            most: largest_variable(program),
        });
    }
    let writers = writers::Writers::of(program)?;
    let Prepared { program, compiled } = prepared(program)?;
    let program = &program;
    let init = RoutineId(program.routines.len() as u32 - 1);
    let linked = link::link(program, &compiled)?;
    let stacks = link::stacks(program, &compiled);
    let mut of_tasks = Vec::new();
    for task in &program.tasks {
        let bytes = stacks[&task.entry];
        if bytes > STACK_BYTES {
            return Err(link::too_much_stack(program, &compiled, &stacks, task));
        }
        of_tasks.push(bytes);
    }
    Ok(Native {
        code: linked.code,
        constants: linked.constants,
        state: initial(program),
        init: linked.routines[init.0 as usize],
        routines: linked.routines,
        stacks: of_tasks,
        traps: linked.traps,
        lines: linked.lines,
        writers,
    })
}

fn largest_variable(program: &Program) -> Most {
    let size = |global: &&crate::hir::Global| program.types.size(global.ty);
    let state = program.globals.iter().filter(|global| global.storage.area == Area::State);
    let largest = state.max_by_key(size);
    largest.map_or_else(Most::default, |global| Most {
        name: global.name.clone(),
        bytes: size(&global).into(),
        location: global.location,
    })
}

/// A program before its routines are placed.
struct Prepared {
    /// With a last routine, which sets the outputs to their initial values.
    program: Program,
    /// The code of each routine.
    compiled: Vec<link::Compiled>,
}

fn prepared(program: &Program) -> Result<Prepared, NativeError> {
    let mut program = program.clone();
    // An index of an array at an output is a LINT.
    program.types.elementary(crate::hir::Elementary::Lint);
    program.add_routine(start::routine(&program));
    let machine = target::machine();
    let knowledge = alias::Knowledge::of(&program);
    let compiled =
        parallel::map(program.routines.len(), FunctionBuilderContext::new, |frontend, index| {
            routine(&program, &knowledge, &*machine, frontend, RoutineId(index as u32))
        })?;
    Ok(Prepared { program, compiled })
}

/// Compiles one routine.
fn routine(
    program: &Program,
    knowledge: &alias::Knowledge,
    machine: &dyn TargetIsa,
    frontend: &mut FunctionBuilderContext,
    id: RoutineId,
) -> Result<link::Compiled, NativeError> {
    let lowered = lower::lower(program, knowledge, id, frontend, machine.frontend_config());
    if lowered.slot_bytes > STACK_BYTES.into() {
        return Err(link::too_large_frame(program, id, lowered.slot_bytes));
    }
    let mut context = Context::for_function(lowered.function);
    if let Err(error) = context.compile(machine, &mut ControlPlane::default()) {
        let routine = program.routine(id).name.clone();
        return Err(NativeError::Internal { routine, message: format!("{:?}", error.inner) });
    }
    let Some(code) = context.compiled_code() else { unreachable!("it was compiled") };
    Ok(link::Compiled::new(
        &context.func,
        code,
        &lowered.locations,
        lowered.constants,
        lowered.loops,
    ))
}

/// The machine code of each routine as text, for `--emit asm`. A routine that is refused is left out: building tells of
/// it.
pub fn assembly(program: &Program) -> String {
    let machine = target::machine();
    each_routine(program, &*machine, |function| {
        let mut context = Context::for_function(function);
        context.set_disasm(true);
        let done = context.compile(&*machine, &mut ControlPlane::default());
        done.ok().and_then(|code| code.vcode.clone())
    })
}

/// The intermediate form of each routine as text, for `--emit ir`.
pub fn intermediate(program: &Program) -> String {
    let machine = target::machine();
    each_routine(program, &*machine, |function| Some(function.display().to_string()))
}

/// A text for each routine, below its name.
fn each_routine(
    program: &Program,
    machine: &dyn TargetIsa,
    text_of: impl Fn(Function) -> Option<String>,
) -> String {
    let knowledge = alias::Knowledge::of(program);
    let mut frontend = FunctionBuilderContext::new();
    let mut all = String::new();
    for index in 0..program.routines.len() {
        let id = RoutineId(index as u32);
        let lowered =
            lower::lower(program, &knowledge, id, &mut frontend, machine.frontend_config());
        if lowered.slot_bytes <= STACK_BYTES.into()
            && let Some(text) = text_of(lowered.function)
        {
            all.push_str(&format!("; {}\n{text}\n", program.routine(id).name));
        }
    }
    all
}

/// The state at a start. What has no initial value is zero.
fn initial(program: &Program) -> Vec<u8> {
    let mut state = vec![0; program.state_size() as usize];
    for global in program.globals.iter().filter(|global| global.storage.area == Area::State) {
        let start = global.storage.offset as usize;
        let end = start + program.types.size(global.ty) as usize;
        let initial: &Constant = &global.initial;
        program.types.encode(global.ty, initial, &mut state[start..end], &|id, fields| {
            field_address(program, id, fields)
        });
    }
    state
}

fn area_address(area: Area) -> u64 {
    match area {
        Area::State => target::address::STATE,
        Area::Input => target::address::INPUT,
        Area::Output => target::address::OUTPUT,
        Area::Marker => target::address::MARKER,
    }
}

fn global_address(program: &Program, id: GlobalId) -> u64 {
    let storage = program.global(id).storage;
    area_address(storage.area) + u64::from(storage.offset)
}

fn field_address(program: &Program, id: GlobalId, fields: &[u32]) -> u64 {
    let offset = program.types.field_offset(program.global(id).ty, fields);
    global_address(program, id) + u64::from(offset)
}
