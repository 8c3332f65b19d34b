//! A program in its process: jobs run one after the other.

use std::time::{Duration, Instant};

use takt_program::{
    ABI_VERSION, CodeOffset, Image, Start, Task, TaskId, TaskInformation, address, call::Error,
};
use takt_st::hir::Simulation;

use super::HostError;
use super::caller::Caller;
use super::child::{Child, Registers, Stop};
use super::fault::{Failed, Fault, Place, describe, place_of_call};
use super::kernel::{Kernel, Outcome};
use super::memory::{Memory, Rights};
use super::outputs::Outputs;
use super::schedule::Logged;

/// The flags register as a function finds it: interrupts on, direction up, no single step. Bit 1 is always set.
const FLAGS: u64 = 0x202;
/// SSE as a function finds it: all exceptions masked, round to nearest (System V ABI, section 3.2.1).
const MXCSR: u32 = 0x1f80;
/// The x87 likewise: all exceptions masked, 64 bits of precision.
const X87_CONTROL: u16 = 0x37f;

/// A program that has been loaded.
pub struct Machine<'a> {
    image: Image<'a>,
    memory: Memory,
    child: Child,
    kernel: Kernel,
    outputs: Outputs<'a>,
    registers: Registers,
    vectors: libc::user_fpregs_struct,
    /// How long a job may run on this machine.
    limit: Duration,
}

/// Why a job is not running.
pub(super) enum Paused {
    /// It is done.
    Ended,
    /// It asks for a simulation, with an argument, and goes on with these registers.
    Asks(Simulation, u64, Box<Registers>),
}

/// One job: which, and when.
pub struct Job<'a> {
    pub task: Task<'a>,
    pub cycle: u64,
    pub now: u64,
    pub period: u64,
}

impl<'a> Machine<'a> {
    /// Loads the program.
    pub fn new(image: Image<'a>, limit: Duration) -> Result<Self, HostError> {
        Self::with_inputs(image, limit, Rights::Read, image.tasks().len())
    }

    /// Loads the program of a test, which sets inputs itself. The last task is the test's.
    pub fn for_test(image: Image<'a>, limit: Duration) -> Result<Self, HostError> {
        Self::with_inputs(image, limit, Rights::Write, image.tasks().len().saturating_sub(1))
    }

    fn with_inputs(
        image: Image<'a>,
        limit: Duration,
        inputs: Rights,
        own: usize,
    ) -> Result<Self, HostError> {
        let memory = Memory::new(&image, inputs)?;
        let child = Child::new(&memory)?;
        let kernel = Kernel::new(&image);
        let registers = child.registers()?;
        let mut vectors = child.vectors()?;
        (vectors.mxcsr, vectors.cwd, vectors.swd, vectors.ftw) = (MXCSR, X87_CONTROL, 0, 0);
        let outputs = Outputs::new(image, own);
        Ok(Self { image, memory, child, kernel, outputs, registers, vectors, limit })
    }

    /// Bytes of the program's memory.
    pub fn get(&self, at: u64, bytes: u64) -> Option<Vec<u8>> {
        self.memory.get(at, bytes)
    }

    /// Sets bytes of the program's memory.
    pub fn put(&self, at: u64, bytes: &[u8]) -> bool {
        self.memory.put(at, bytes)
    }

    /// Runs `init` for a cold start, if the program has one. What it logs is added, also if it ends in a fault.
    pub fn init(&mut self, logged: &mut Vec<Logged>) -> Result<(), Failed> {
        let (Some(entry), Some(task)) = (self.image.init(), self.image.task(TaskId(0))) else {
            return Ok(());
        };
        let information =
            TaskInformation { task: TaskInformation::INIT, ..self.information(0, 0, 0) };
        let ran = self.run("init", &task, entry, information, &Caller::init(0));
        self.take_log("init", 0, logged);
        ran
    }

    /// Runs a job. What it has logged is taken with [`Self::take_log`].
    pub fn job(&mut self, job: &Job<'_>) -> Result<(), Failed> {
        let task = job.task.id.0.into();
        let information =
            TaskInformation { task, ..self.information(job.cycle, job.now, job.period) };
        let before = self.outputs.get(&self.memory);
        let caller = Caller::task(&job.task, job.now);
        self.run(job.task.name, &job.task, job.task.entry, information, &caller)?;
        match self.outputs.foreign(&self.memory, &before, job.task.id) {
            None => {
                self.outputs.restore(&self.memory, &before);
                Ok(())
            }
            Some(name) => {
                let what = format!("it changed the output `{name}`, which another task writes");
                Err(self.fault(
                    job.task.name,
                    information,
                    what,
                    Place::Words("somewhere in the job".into()),
                ))
            }
        }
    }

    pub(super) fn information(&self, cycle: u64, now: u64, period: u64) -> TaskInformation {
        let (version, start) = (ABI_VERSION.into(), Start::Cold.code());
        TaskInformation { version, cycle, now, period, start, ..TaskInformation::default() }
    }

    fn run(
        &mut self,
        name: &str,
        task: &Task<'_>,
        entry: CodeOffset,
        information: TaskInformation,
        caller: &Caller,
    ) -> Result<(), Failed> {
        let mut registers = self.enter(task, entry, &information)?;
        let deadline = self.deadline();
        loop {
            match self.go(name, &information, caller, registers, deadline)? {
                Paused::Ended => return Ok(()),
                // Only tests ask, and a kernel knows no such call.
                Paused::Asks(_, _, at) => {
                    registers = *at;
                    registers.rax = Error::BadNumber.result().cast_unsigned();
                }
            }
        }
    }

    /// Tells a task about its job; returns where the task finds it.
    pub(super) fn inform(&mut self, information: &TaskInformation) -> u64 {
        let task =
            (information.task != TaskInformation::INIT).then_some(TaskId(information.task as u16));
        let at = address::task_information(task);
        self.memory.put(at, &bytes(information));
        at
    }

    /// The registers with which a job begins.
    pub(super) fn enter(
        &mut self,
        task: &Task<'_>,
        entry: CodeOffset,
        information: &TaskInformation,
    ) -> Result<Registers, HostError> {
        let argument = self.inform(information);
        let stack = address::stack_end(task.id) - 8;
        self.memory.put(stack, &address::CALL_PAGE.to_le_bytes());
        self.child.set_vectors(&self.vectors)?;
        let mut registers = self.registers;
        (registers.rip, registers.rsp, registers.rdi) = (entry.address(), stack, argument);
        // No system call was interrupted, so the kernel has none to restart.
        (registers.eflags, registers.rbp, registers.orig_rax) = (FLAGS, 0, u64::MAX);
        Ok(registers)
    }

    /// When a job that goes on now has run for too long.
    pub(super) fn deadline(&self) -> Instant {
        Instant::now() + self.limit
    }

    /// Runs a job from these registers to its end, or until it asks for something that only a test does.
    pub(super) fn go(
        &mut self,
        name: &str,
        information: &TaskInformation,
        caller: &Caller,
        mut registers: Registers,
        deadline: Instant,
    ) -> Result<Paused, Failed> {
        loop {
            let stop = self.child.run(&registers, deadline)?;
            let stop = self.foreign(stop);
            if let Stop::Call(at_call) = stop {
                let arguments = [at_call.rdi, at_call.rsi, at_call.rdx, at_call.r10];
                let number = at_call.orig_rax;
                if let Some(request) = Simulation::of(number) {
                    registers = at_call;
                    registers.orig_rax = u64::MAX;
                    return Ok(Paused::Asks(request, arguments[0], Box::new(registers)));
                }
                match self.kernel.call(&self.memory, caller, number, arguments) {
                    Outcome::Result(result) => {
                        registers = at_call;
                        (registers.rax, registers.orig_rax) = (result.cast_unsigned(), u64::MAX);
                    }
                    Outcome::End => {
                        self.kernel.job_ended(caller);
                        return Ok(Paused::Ended);
                    }
                    Outcome::Stop(code) => {
                        let (_, place) = describe(&self.image, &self.memory, &stop);
                        let what = format!("it stopped the program with code {code}");
                        return Err(self.fault(name, *information, what, place));
                    }
                }
            } else {
                let (what, place) = describe(&self.image, &self.memory, &stop);
                return Err(self.fault(name, *information, what, place));
            }
        }
    }

    /// A message between a test, which stands for the other partition, and the program. Gives the registers with
    /// which the test goes on.
    pub(super) fn exchange(&mut self, request: Simulation, mut at: Registers) -> Registers {
        let arguments = [at.rdi, at.rsi, at.rdx, at.r10];
        let result = match request {
            Simulation::Take => self.kernel.take(&self.memory, arguments),
            _ => self.kernel.give(&self.memory, arguments),
        };
        at.rax = result.cast_unsigned();
        at
    }

    /// How many messages wait at the port of this name.
    pub fn waiting(&self, port: &str) -> usize {
        let at = self.image.ports().position(|known| known.name == port);
        at.map_or(0, |at| self.kernel.waiting(at))
    }

    /// Takes what was logged since the last time, by this task.
    pub(super) fn take_log(&mut self, task: &str, now: u64, logged: &mut Vec<Logged>) {
        let lines = std::mem::take(&mut self.kernel.log).into_iter();
        logged.extend(lines.map(|line| Logged { task: task.to_owned(), now, line }));
    }

    /// The state of FPU and SSE.
    pub(super) fn vectors(&self) -> Result<libc::user_fpregs_struct, HostError> {
        self.child.vectors()
    }

    /// Sets the state of FPU and SSE.
    pub(super) fn set_vectors(&self, vectors: &libc::user_fpregs_struct) -> Result<(), HostError> {
        self.child.set_vectors(vectors)
    }

    /// A fault by a call that the program makes with these registers.
    pub(super) fn fault_here(
        &self,
        name: &str,
        information: TaskInformation,
        what: String,
        at: &Registers,
    ) -> Failed {
        let place = place_of_call(&self.image, &self.memory, at);
        self.fault(name, information, what, place)
    }

    /// A stop by a system call, but not by the instruction `syscall`, is not a call of ours.
    fn foreign(&self, stop: Stop) -> Stop {
        const SYSCALL: [u8; 2] = [0x0f, 0x05];
        match stop {
            Stop::Call(registers)
                if self.memory.get(registers.rip.wrapping_sub(2), 2).as_deref()
                    != Some(&SYSCALL) =>
            {
                Stop::ForeignCall(registers)
            }
            stop => stop,
        }
    }

    fn fault(&self, task: &str, job: TaskInformation, what: String, place: Place) -> Failed {
        let last_words = self.kernel.log.last().cloned();
        let (cycle, now, task) = (job.cycle, job.now, task.to_owned());
        Failed::Program(Fault { task, cycle, now, what, place, last_words })
    }
}

/// The page's content, as the program finds it.
fn bytes(information: &TaskInformation) -> [u8; 64] {
    let mut page = [0; 64];
    let TaskInformation { version, task, cycle, now, period, start, flags, .. } = information;
    page[0..4].copy_from_slice(&version.to_le_bytes());
    page[4..8].copy_from_slice(&task.to_le_bytes());
    page[8..16].copy_from_slice(&cycle.to_le_bytes());
    page[16..24].copy_from_slice(&now.to_le_bytes());
    page[24..32].copy_from_slice(&period.to_le_bytes());
    page[32..36].copy_from_slice(&start.to_le_bytes());
    page[36..40].copy_from_slice(&flags.to_le_bytes());
    page
}
