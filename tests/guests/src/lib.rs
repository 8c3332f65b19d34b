//! Program images for tests of the PLC's kernel.
//!
//! What a compiler makes is well-behaved. What is asked here is what the kernel does with programs that
//! are not, and with registers that no compiler would use: so the functions are assembler, a few
//! instructions each. They are assembled into this crate as data, since they only run in a PLC, and all
//! addresses in them are those of a program's own address space ([`takt_program::address`]).
//!
//! The first words of the state are each task's own: a function finds its parameter at [`parameter`], and
//! counts its jobs in the word behind it.

#[macro_use]
mod functions;
mod code;

pub use code::{Entry, trap_of};
use takt_program::build::{Builder, Event, Object, Place, Port, Task, Trap, Variable, When};
use takt_program::{Area, Direction, Elementary, Nanoseconds, TaskId, TrapKind, TypeId};

/// Bytes of the state that belong to one task.
const EACH: usize = 64;
/// Size of the state of all programs.
const STATE_BYTES: u32 = 0x4000;

/// Where the parameter of a task lies in the state.
#[must_use]
pub const fn parameter(task: usize) -> usize {
    task * EACH
}

/// A program in the making.
#[derive(Clone, Debug)]
pub struct Program(Builder);

/// The length of time of so many microseconds.
#[must_use]
pub const fn us(microseconds: u64) -> Nanoseconds {
    Nanoseconds(microseconds * 1_000)
}

impl Program {
    /// Without tasks.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let mut builder = Builder::new(name);
        builder.code = code::bytes().to_vec();
        builder.state_bytes = STATE_BYTES;
        builder.constants = vec![0x5a; 64];
        if let Some(at) = trap_of(Entry::Divide) {
            let place = Some(Place { file: "tank.st".into(), line: 12, column: 7 });
            builder.trap(Trap { at, kind: TrapKind::ZeroDivide, place });
        }
        Self(builder)
    }

    /// With a function that runs at the start.
    #[must_use]
    pub fn init(mut self, entry: Entry) -> Self {
        self.0.init = Some(entry.offset());
        self
    }

    /// One more task, with a parameter.
    #[must_use]
    pub fn task(mut self, task: Task, parameter: u64) -> Self {
        let number = usize::from(self.0.task(task).0);
        let at = self::parameter(number);
        if self.0.state.len() < at + EACH {
            self.0.state.resize(at + EACH, 0);
        }
        self.0.state[at..at + 8].copy_from_slice(&parameter.to_le_bytes());
        self
    }

    /// With a state of so many bytes.
    #[must_use]
    pub fn state_bytes(mut self, bytes: u32) -> Self {
        self.0.state_bytes = bytes;
        self
    }

    /// One more kernel object.
    #[must_use]
    pub fn object(mut self, object: Object) -> Self {
        self.0.object(object);
        self
    }

    /// One more port, for messages of 8 bytes.
    #[must_use]
    pub fn port(mut self, name: &str, direction: Direction) -> Self {
        self.0.port(Port { name: name.into(), direction, message_bytes: 8 });
        self
    }

    /// With an input at this byte.
    #[must_use]
    pub fn input(self, name: &str, ty: Elementary, offset: u32) -> Self {
        self.point(Variable::new(name, TypeId(0), Area::Input, offset), ty)
    }

    /// With an output at this byte, which the task of this number writes.
    #[must_use]
    pub fn output(self, name: &str, ty: Elementary, offset: u32, task: u16) -> Self {
        let variable = Variable::new(name, TypeId(0), Area::Output, offset);
        self.point(Variable { writer: Some(TaskId(task)), ..variable }, ty)
    }

    fn point(mut self, variable: Variable, ty: Elementary) -> Self {
        let bytes = match variable.area {
            Area::Input => &mut self.0.input_bytes,
            _ => &mut self.0.output_bytes,
        };
        *bytes = (*bytes).max(variable.offset + ty.bytes());
        let ty = self.0.elementary(ty);
        self.0.variable(Variable { ty, ..variable });
        self
    }

    /// Names the bit that [`Entry::Toggle`] changes.
    #[must_use]
    pub fn bit(mut self, name: &str) -> Self {
        let bool = self.0.elementary(Elementary::Bool);
        self.0.variable(Variable::new(name, bool, Area::State, 0x3010));
        self
    }

    /// The image.
    ///
    /// # Panics
    /// If it is not valid.
    #[must_use]
    pub fn image(&self) -> Vec<u8> {
        self.0.build().expect("the test's program is valid")
    }
}

/// A cyclic task of a priority.
#[must_use]
pub fn cyclic(name: &str, period: Nanoseconds, priority: u8, entry: Entry) -> Task {
    Task { priority, ..Task::cyclic(name, period, entry.offset()) }
}

/// A cyclic task, first released this long after the tasks have begun.
#[must_use]
pub fn cyclic_from(offset: Nanoseconds, task: Task) -> Task {
    match task.when {
        When::Cyclic { period, .. } => Task { when: When::Cyclic { period, offset }, ..task },
        _ => task,
    }
}

/// A task that runs in what is left of the windows.
#[must_use]
pub fn freewheeling(name: &str, priority: u8, entry: Entry) -> Task {
    Task { priority, ..Task::new(name, When::Freewheeling, entry.offset()) }
}

/// A task that an event releases.
#[must_use]
pub fn on(name: &str, source: Event, minimum: Nanoseconds, priority: u8, entry: Entry) -> Task {
    Task { priority, ..Task::new(name, When::Event { source, minimum }, entry.offset()) }
}
