//! What is told of errors of tasks.
//!
//! A line says which program and task it was, what happened, where in the source if the image knows, and
//! what follows. It costs one exit of the partition's window, and only errors have it. It is printed behind the window's
//! release, however late the error was found.

use super::context::Fault;
use super::kernel::Kernel;
use super::lines::Allowance;
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
    /// How many lines it may have for errors of this kind.
    fn allowance(&mut self, error: Untold) -> &mut Allowance {
        match error {
            Untold::Fault(..) => &mut self.fault_lines,
            Untold::Violation { .. } => &mut self.violation_lines,
        }
    }

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

/// An error of which a line is still to be printed.
#[derive(Clone, Copy, Debug)]
pub enum Untold {
    /// An exception; with true if the version was on trial.
    Fault(Fault, bool),
    /// A limit that a job did not keep.
    Violation {
        /// In words.
        what: &'static str,
        /// What the partition file wants.
        wanted: u32,
        /// True if the version was on trial and is left for it.
        leaves: bool,
    },
}

impl Kernel {
    /// Has an error of a task told. A second one of the same task before that counts as a line too many.
    pub fn tell(&mut self, id: TaskId, error: Untold) {
        match &mut self.untold[id.index()] {
            free @ None => *free = Some(error),
            Some(_) => {
                if let Some(program) =
                    &mut self.programs[usize::from(self.places[id.index()].program)]
                {
                    program.allowance(error).drop_line();
                }
            }
        }
        self.has_untold |= 1 << id.0;
    }

    /// Prints a line that waits, unless that might delay a release: many errors are found at a window's start, in the time
    /// that its most urgent task needs. False if there is nothing to print now.
    pub fn print_untold(&mut self) -> bool {
        self.has_untold != 0 && self.window.is_at_work() && self.print_next()
    }

    /// Prints all lines that wait.
    pub fn print_all_untold(&mut self) {
        while self.print_next() {}
    }

    fn print_next(&mut self) -> bool {
        let task = self.has_untold.trailing_zeros() as usize;
        let Some(error) = self.untold.get_mut(task).and_then(Option::take) else { return false };
        self.has_untold &= self.has_untold - 1;
        let place = self.places[task];
        let now = self.now();
        let Some(program) = &mut self.programs[usize::from(place.program)] else { return true };
        // A task that fails in each job must neither fill the console nor cost its neighbours an exit each time.
        let Some(dropped) = program.allowance(error).take(now) else { return true };
        let (name, task) = (program.name(), program.task_name(place.number));
        match error {
            Untold::Fault(fault, on_trial) => {
                if dropped > 0 {
                    print(format_args!("program {name}: {dropped} faults were not told"));
                }
                let rip = fault.frame.rip;
                print(format_args!(
                    "program {name}, task {task}: {}{}{} at {rip:#x}: {}",
                    Line(rip, program),
                    What(&fault, program),
                    Column(rip, program),
                    consequence(on_trial, program.entry.on_fault),
                ));
            }
            Untold::Violation { what, wanted, leaves } => {
                if dropped > 0 {
                    print(format_args!("program {name}: {dropped} missed limits were not told"));
                }
                print(format_args!(
                    "program {name}, task {task}: {what}: {}",
                    consequence(leaves, wanted),
                ));
            }
        }
        true
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
