//! Programs: variables with their storage, routines and tasks.

use std::sync::Arc;

use takt_program::Direction;

use super::{Block, Constant, TypeId, Types};

/// A place in a source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Location {
    /// The index in [`Program::files`].
    pub file: u16,
    /// From 1.
    pub line: u32,
    /// From 1, in characters.
    pub column: u32,
}

/// A global variable of a [`Program`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct GlobalId(pub u32);

/// A parameter or local variable of a [`Routine`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LocalId(pub u32);

/// A routine of a [`Program`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RoutineId(pub u32);

/// A whole program: everything of one image.
#[derive(Clone, Debug, Default)]
pub struct Program {
    /// The image's name.
    pub name: String,
    /// The author's version.
    pub version: takt_program::Version,
    /// The category, of the author's choice.
    pub category: u32,
    /// The sources' names, as they are shown.
    pub files: Vec<String>,
    /// All types.
    pub types: Types,
    /// Global variables and program instances.
    pub globals: Vec<Global>,
    /// Functions, bodies of function blocks and programs, entries of tasks. Calls form no cycle.
    /// They are shared: a copy of a program does not copy them.
    pub routines: Vec<Arc<Routine>>,
    /// The tasks, at most 16.
    pub tasks: Vec<Task>,
    /// The kernel's objects.
    pub objects: Vec<Object>,
    /// The ends of channels that it reads and writes.
    pub ports: Vec<Port>,
    /// The tests, if any were asked for.
    pub tests: super::Tests,
    /// Rounds that one execution of a loop may make; the next one traps.
    pub loop_budget: u32,
}

/// What the loop budget is if nothing else is said: 16,777,216 rounds, some tens of milliseconds.
pub const DEFAULT_LOOP_BUDGET: u32 = 1 << 24;

impl Program {
    /// A program without anything.
    pub fn new(name: &str) -> Program {
        Program { name: name.to_owned(), loop_budget: DEFAULT_LOOP_BUDGET, ..Program::default() }
    }

    /// The global variable `id`.
    pub fn global(&self, id: GlobalId) -> &Global {
        &self.globals[id.0 as usize]
    }

    /// The routine `id`.
    pub fn routine(&self, id: RoutineId) -> &Routine {
        &self.routines[id.0 as usize]
    }

    /// Adds a variable in the state, at the next offset that its alignment allows.
    pub fn add_state(
        &mut self,
        name: &str,
        ty: TypeId,
        initial: Constant,
        location: Location,
    ) -> GlobalId {
        let offset = self.state_size().next_multiple_of(self.types.align(ty).max(1));
        let storage = Storage { area: Area::State, offset, bit: None };
        self.add_global(Global {
            name: name.to_owned(),
            ty,
            storage,
            initial,
            retention: Retention::None,
            constant: false,
            location,
        })
    }

    /// Adds a variable whose storage is given.
    pub fn add_global(&mut self, global: Global) -> GlobalId {
        self.globals.push(global);
        GlobalId(self.globals.len() as u32 - 1)
    }

    /// Adds a routine.
    pub fn add_routine(&mut self, routine: Routine) -> RoutineId {
        self.routines.push(Arc::new(routine));
        RoutineId(self.routines.len() as u32 - 1)
    }

    /// Where the variables in the state end, in bytes.
    pub fn state_size(&self) -> u32 {
        self.area_size(Area::State)
    }

    /// Where the variables of an area end, in bytes.
    pub fn area_size(&self, area: Area) -> u32 {
        let ends = self.globals.iter().filter(|global| global.storage.area == area);
        ends.map(|global| global.storage.offset + self.types.size(global.ty)).max().unwrap_or(0)
    }
}

/// A global variable or a program instance.
#[derive(Clone, Debug, PartialEq)]
pub struct Global {
    /// The name as declared.
    pub name: String,
    /// The type.
    pub ty: TypeId,
    /// Where it lies.
    pub storage: Storage,
    /// The initial value. Inputs have none.
    pub initial: Constant,
    /// RETAIN or PERSISTENT.
    pub retention: Retention,
    /// `CONSTANT`: no routine assigns it.
    pub constant: bool,
    /// Where it is declared.
    pub location: Location,
}

/// Where a global variable lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Storage {
    /// The area.
    pub area: Area,
    /// The offset in bytes from the area's start, a multiple of the type's alignment in the state.
    pub offset: u32,
    /// The bit of that byte, of a BOOL at a bit address such as `%IX0.3`.
    pub bit: Option<u8>,
}

/// An area of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Area {
    /// The program's own state.
    State,
    /// `%I`.
    Input,
    /// `%Q`.
    Output,
    /// `%M`.
    Marker,
}

/// Whether a variable outlives a restart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Retention {
    /// NON_RETAIN in a function block: it does not, in whatever instance.
    Never,
    /// It does not, but in an instance that does.
    #[default]
    None,
    /// RETAIN: it outlives a warm restart.
    Retain,
    /// PERSISTENT: it outlives a new version of the program too.
    Persistent,
}

/// A function, the body of a function block or program, or the entry of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct Routine {
    /// The name as declared.
    pub name: String,
    /// The structure whose instance the routine runs on, for function blocks and programs.
    pub instance: Option<TypeId>,
    /// Parameters and local variables. The parameters are those whose kind is Input, InOut or Output, in this order.
    pub locals: Vec<Local>,
    /// The local variable, of kind [`LocalKind::Variable`], whose value is the function's result.
    pub result: Option<LocalId>,
    /// What it does.
    pub body: Block,
    /// Where it is declared.
    pub location: Location,
}

impl Routine {
    /// The local `id`.
    pub fn local(&self, id: LocalId) -> &Local {
        &self.locals[id.0 as usize]
    }

    /// The parameters with their indices.
    pub fn parameters(&self) -> impl Iterator<Item = (LocalId, &Local)> {
        let all =
            self.locals.iter().enumerate().map(|(index, local)| (LocalId(index as u32), local));
        all.filter(|(_, local)| local.kind != LocalKind::Variable)
    }
}

/// A parameter or a local variable. It lives from the routine's call to its return.
#[derive(Clone, Debug, PartialEq)]
pub struct Local {
    /// The name as declared, or one of the compiler's.
    pub name: String,
    /// The type.
    pub ty: TypeId,
    /// What it is.
    pub kind: LocalKind,
    /// What it begins with, at each call, if it is a variable or an output.
    pub initial: Constant,
}

/// What a local variable is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LocalKind {
    /// `VAR_INPUT`: a copy of the argument, which the routine may change for itself.
    Input,
    /// `VAR_IN_OUT`: stands for the argument's place. The type may be an open array.
    InOut,
    /// `VAR_OUTPUT`: a variable that is copied to the argument's place when the routine returns.
    Output,
    /// `VAR`, `VAR_TEMP`, the result, and what the compiler adds.
    Variable,
}

/// A task.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// The name.
    pub name: String,
    /// When it is released.
    pub kind: TaskKind,
    /// 0 is the most urgent.
    pub priority: u8,
    /// Execution time that a job may take, in nanoseconds; 0 for no bound.
    pub budget_ns: u64,
    /// From release to end, in nanoseconds; 0 for the period.
    pub deadline_ns: u64,
    /// A routine without instance, parameters and result.
    pub entry: RoutineId,
    /// Where it is declared.
    pub location: Location,
}

/// When a task is released.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TaskKind {
    /// `INTERVAL`: at `offset_ns` and each `period_ns` after it.
    Cyclic {
        /// In nanoseconds.
        period_ns: u64,
        /// In nanoseconds.
        offset_ns: u64,
    },
    /// When something happens, at most once in `minimum_ns`.
    Event {
        /// What.
        source: Event,
        /// In nanoseconds.
        minimum_ns: u64,
    },
    /// Whenever nothing else is ready.
    Freewheeling,
}

/// What releases a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// `SINGLE`: the rising edge of the variable of this name.
    Rise(String),
    /// `CHANNEL`: a message at the port of this name, which the program reads.
    Channel(String),
}

/// An end of a channel. The partition file connects it by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// The name.
    pub name: String,
    /// Whether the program reads or writes it.
    pub direction: Direction,
    /// The size of the longest message in bytes.
    pub bytes: u32,
}

/// An object of the kernel that the program uses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// The name.
    pub name: String,
    /// What it is.
    pub kind: ObjectKind,
}

/// What an object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKind {
    /// A semaphore with the priority of its most urgent user.
    Semaphore {
        /// The ceiling.
        ceiling: u8,
    },
    /// A bounded queue of messages.
    Queue {
        /// Bytes of a message.
        message: u32,
        /// How many messages it holds.
        depth: u32,
    },
    /// The newest message only.
    Mailbox {
        /// Bytes of the message.
        bytes: u32,
    },
    /// 64 event flags.
    Flags,
}
