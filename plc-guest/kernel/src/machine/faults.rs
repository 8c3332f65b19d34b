//! What is told of errors of tasks.
//!
//! A line says which program and task it was, what happened, where in the source if the image knows, and
//! what follows. It costs one exit of the partition's window, and only errors have it.

use super::context::Fault;
use super::kernel::Kernel;
use super::program::Program;
use core::fmt;
use takt_abi::exception_name;
use takt_abi::program::action;
use takt_kernel::task::TaskId;
use takt_plc_guest::console::print;
use takt_program::CodeOffset;
use takt_program::address::CODE;

/// Vectors that have more to say than their name.
const INVALID_OPCODE: u64 = 6;
const PAGE_FAULT: u64 = 14;
/// Bits of the error code of a page fault: written, fetched (AMD64 volume 2, section 8.2.15).
const WRITTEN: u64 = 1 << 1;
const FETCHED: u64 = 1 << 4;

impl Program {
    /// The name of a task of the image; of the initialisation without a number.
    pub fn task_name(&self, number: Option<u16>) -> &'static str {
        let task = number.and_then(|number| self.image.tasks().nth(number.into()));
        match (number, task) {
            (_, Some(task)) => task.name,
            (None, _) => "init",
            (Some(_), None) => "?",
        }
    }
}

/// What follows from an error: first of all that a version on trial is left.
fn consequence(leaves: bool, wanted: u32) -> &'static str {
    match wanted {
        _ if leaves => "the version before comes back",
        action::LOG => "it goes on",
        action::SKIP => "its job ends",
        action::WARM_RESTART_PROGRAM => "the program starts anew, warm",
        action::RESTART_PROGRAM => "the program starts anew",
        action::STOP_PARTITION => "the partition stops",
        _ => "the program stops",
    }
}

impl Kernel {
    /// Tells of an exception.
    pub fn tell_fault(&mut self, id: TaskId, fault: &Fault) {
        let place = self.places[id.index()];
        let now = self.now();
        let on_trial = self.change.is_on_trial(place.program);
        let Some(program) = &mut self.programs[usize::from(place.program)] else { return };
        // A program that starts anew and fails, again and again, must not fill the console.
        let Some(untold) = program.fault_lines.take(now) else { return };
        if untold > 0 {
            print(format_args!("program {}: {untold} faults were not told", program.name()));
        }
        print(format_args!(
            "program {}, task {}: {}{}{} at {:#x}: {}",
            program.name(),
            program.task_name(place.number),
            Line(fault.frame.rip, program),
            What(fault, program),
            Column(fault.frame.rip, program),
            fault.frame.rip,
            consequence(on_trial, program.entry.on_fault),
        ));
    }

    /// Tells of a limit that a job did not keep; `leaves` if its version is on trial and is left for it.
    pub fn tell_violation(&mut self, id: TaskId, what: &str, wanted: u32, leaves: bool) {
        let place = self.places[id.index()];
        let now = self.now();
        let Some(program) = &mut self.programs[usize::from(place.program)] else { return };
        // A task that misses each of its deadlines must not cost its neighbours an exit each time.
        let Some(dropped) = program.lines.take(now) else { return };
        if dropped > 0 {
            print(format_args!("{}: {dropped} lines were too many", program.name()));
        }
        print(format_args!(
            "program {}, task {}: {what}: {}",
            program.name(),
            program.task_name(place.number),
            consequence(leaves, wanted),
        ));
    }
}

/// What happened, in words.
struct What<'a>(&'a Fault, &'a Program);

impl fmt::Display for What<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(fault, program) = self;
        let frame = &fault.frame;
        let trap = offset(frame.rip).and_then(|at| program.image.trap(at));
        match (frame.vector, trap) {
            (INVALID_OPCODE, Some(trap)) => f.write_str(trap.kind.words()),
            (PAGE_FAULT, _) => {
                let way = match frame.error_code {
                    code if code & FETCHED != 0 => "execution",
                    code if code & WRITTEN != 0 => "write",
                    _ => "read",
                };
                write!(f, "page fault, {way} of {:#x}", fault.cr2)
            }
            (vector, _) => f.write_str(exception_name(vector).unwrap_or("exception")),
        }
    }
}

/// File and line, if the image knows them: in front of what happened, as compilers tell it.
struct Line<'a>(u64, &'a Program);

impl fmt::Display for Line<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(at) = offset(self.0) else { return Ok(()) };
        let image = &self.1.image;
        let line = || image.line(at).map(|line| (line.file, line.line));
        match image.trap(at).map_or_else(line, |trap| trap.place.map(|p| (p.file, p.line))) {
            Some((file, line)) => write!(f, "{file}:{line}: "),
            None => Ok(()),
        }
    }
}

/// The column, which traps of a compiler have that knows it.
struct Column<'a>(u64, &'a Program);

impl fmt::Display for Column<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trap = offset(self.0).and_then(|at| self.1.image.trap(at));
        match trap.and_then(|trap| trap.place).filter(|place| place.column > 0) {
            Some(place) => write!(f, " (column {})", place.column),
            None => Ok(()),
        }
    }
}

/// Where an instruction is in the code.
fn offset(rip: u64) -> Option<CodeOffset> {
    rip.checked_sub(CODE).and_then(|offset| u32::try_from(offset).ok()).map(CodeOffset)
}
