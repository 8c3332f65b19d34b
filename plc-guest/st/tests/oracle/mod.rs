//! The interpreter of the typed tree: what compiled programs are compared with.
//!
//! It is written for being obviously right, not for speed, and shares no code with the code generator: integers are
//! `i128` and wrapped after each operation, strings are vectors, each place is an address that is computed anew. Its
//! memory is laid out like the compiled program's, so that the two can be compared byte by byte.

mod expr;
mod memory;
mod place;
mod statement;
mod value;

use std::collections::BTreeMap;

use takt_st::hir::{
    Area, Argument, Constant, GlobalId, LocalKind, Program, RoutineId, Trap, TrapKind, TypeId,
};

pub use memory::Memory;
pub use value::Value;

/// What the kernel tells a task about its job.
#[derive(Clone, Copy, Debug, Default)]
pub struct Job {
    pub now_ns: u64,
    pub elapsed_ns: u64,
    pub cycle: u64,
}

/// Where the areas begin.
pub fn area_address(area: Area) -> u64 {
    match area {
        Area::State => 0x5000_0000,
        Area::Input => 0x6800_0000,
        Area::Output => 0x6810_0000,
        Area::Marker => 0x6820_0000,
    }
}

/// A running program.
pub struct Machine<'p> {
    program: &'p Program,
    pub memory: Memory,
    job: Job,
    /// Statements that may still be executed: generated programs are bounded, but their product of loops may be large.
    pub fuel: u64,
    /// Indices that are no constants and were looked up.
    pub indices: u64,
}

/// Why an execution ended before its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    Trap(Trap),
    /// The test's own bound, not a property of the program.
    OutOfFuel,
}

type Outcome<T> = Result<T, Stop>;

/// One call of a routine.
struct Frame {
    routine: RoutineId,
    /// The address of the instance.
    instance: u64,
    /// The address of each local, or of what it stands for.
    locals: Vec<u64>,
    /// The bounds of open arrays: lower and upper of each dimension.
    bounds: BTreeMap<u32, Vec<(i64, i64)>>,
}

impl<'p> Machine<'p> {
    /// The program with its initial values.
    pub fn new(program: &'p Program) -> Machine<'p> {
        let mut memory = Memory::new();
        for area in [Area::State, Area::Input, Area::Output, Area::Marker] {
            memory.map(area_address(area), program.area_size(area) as usize);
        }
        let mut machine =
            Machine { program, memory, job: Job::default(), fuel: u64::MAX, indices: 0 };
        for global in &program.globals {
            if global.storage.area == Area::Input {
                continue;
            }
            let address = area_address(global.storage.area) + u64::from(global.storage.offset);
            match (global.storage.bit, &global.initial) {
                (Some(bit), initial) => {
                    let byte = machine.memory.read(address, 1)[0];
                    let set = u8::from(*initial == Constant::Integer(1)) << bit;
                    machine.memory.write(address, &[byte & !(1 << bit) | set]);
                }
                (None, initial) => machine.initialise(address, global.ty, initial),
            }
        }
        machine
    }

    fn global_address(&self, id: GlobalId) -> u64 {
        let storage = self.program.global(id).storage;
        area_address(storage.area) + u64::from(storage.offset)
    }

    fn initialise(&mut self, address: u64, ty: TypeId, value: &Constant) {
        let mut bytes = vec![0; self.program.types.size(ty) as usize];
        self.program.types.encode(ty, value, &mut bytes, &|id, fields| {
            let offset = self.program.types.field_offset(self.program.global(id).ty, fields);
            self.global_address(id) + u64::from(offset)
        });
        self.memory.write(address, &bytes);
    }

    /// Runs the entry of a task once.
    pub fn run(&mut self, entry: RoutineId, job: Job) -> Outcome<()> {
        self.job = job;
        self.call_routine(None, entry, 0, &[]).map(|_| ())
    }

    /// Calls `routine`; `caller` is the frame that the arguments are evaluated in.
    fn call_routine(
        &mut self,
        caller: Option<&Frame>,
        id: RoutineId,
        instance: u64,
        arguments: &[Argument],
    ) -> Outcome<Option<Value>> {
        let program = self.program;
        let routine = program.routine(id);
        let mark = self.memory.mark();
        let mut frame =
            Frame { routine: id, instance, locals: Vec::new(), bounds: BTreeMap::new() };
        let mut outputs = Vec::new();
        let mut given = arguments.iter();
        for (index, local) in routine.locals.iter().enumerate() {
            let size = program.types.size(local.ty) as usize;
            let argument = if local.kind == LocalKind::Variable { None } else { given.next() };
            let address = match (local.kind, argument) {
                (LocalKind::InOut, Some(Argument::Reference(place))) => {
                    let caller = caller.expect("arguments need a caller");
                    let target = self.place(caller, place)?;
                    if let Some(bounds) = self.bounds_of(caller, place, local.ty) {
                        frame.bounds.insert(index as u32, bounds);
                    }
                    target.address
                }
                (LocalKind::Input, Some(Argument::Value(value))) => {
                    let caller = caller.expect("arguments need a caller");
                    let value = self.expr(caller, value)?;
                    let address = self.memory.allocate(size);
                    self.store(address, local.ty, &value);
                    address
                }
                (LocalKind::Output, Some(Argument::Output(place))) => {
                    let address = self.memory.allocate(size);
                    if let Some(place) = place {
                        let caller = caller.expect("arguments need a caller");
                        outputs.push((self.place(caller, place)?, address, local.ty));
                    }
                    address
                }
                (LocalKind::Variable, _) => self.memory.allocate(size),
                (kind, argument) => {
                    panic!("parameter {} is {kind:?} and is given {argument:?}", local.name)
                }
            };
            frame.locals.push(address);
        }
        for (local, &address) in routine.locals.iter().zip(&frame.locals) {
            if matches!(local.kind, LocalKind::Variable | LocalKind::Output) {
                self.initialise(address, local.ty, &local.initial);
            }
        }
        self.block(&frame, &routine.body)?;
        let result =
            routine.result.map(|id| self.load(frame.locals[id.0 as usize], routine.local(id).ty));
        for (target, address, ty) in outputs {
            let value = self.load(address, ty);
            self.store_target(&target, ty, &value);
        }
        self.memory.release(mark);
        Ok(result)
    }

    fn spend(&mut self) -> Outcome<()> {
        self.fuel = self.fuel.checked_sub(1).ok_or(Stop::OutOfFuel)?;
        Ok(())
    }
}

fn trap<T>(kind: TrapKind, location: takt_st::hir::Location) -> Outcome<T> {
    Err(Stop::Trap(Trap { kind, location }))
}
