//! What a fault is, in words, with the place in the source.

use std::ffi::c_int;
use std::fmt;

use takt_program::{CodeOffset, Image, address, limit};

use super::HostError;
use super::child::{Registers, Stop};
use super::memory::{Memory, Rights};

/// Why a program does not run on.
#[derive(Debug)]
pub enum Failed {
    /// This machine's fault.
    Host(HostError),
    /// The program's.
    Program(Fault),
}

impl From<HostError> for Failed {
    fn from(error: HostError) -> Self {
        Self::Host(error)
    }
}

/// A fault of the program, and where it happened.
#[derive(Debug)]
pub struct Fault {
    /// `init`, or a task's name.
    pub task: String,
    /// Jobs of the task before this one.
    pub cycle: u64,
    /// Simulated time, in nanoseconds.
    pub now: u64,
    /// What happened.
    pub what: String,
    /// Where.
    pub place: Place,
    /// The last line of the log in this job, which says why if the program gave up by itself.
    pub last_words: Option<String>,
}

/// Where a fault happened.
#[derive(Debug)]
pub enum Place {
    /// `FILE:LINE`, which editors understand at the beginning of a message.
    Source(String),
    /// In words: an address, or the place of a caller.
    Words(String),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, cycle, now, what, place, .. } = self;
        let now = takt_program::Nanoseconds(*now);
        match place {
            Place::Source(place) => {
                write!(f, "{place}: {what} (task {task}, job {cycle}, at {now})")
            }
            Place::Words(place) => write!(f, "task {task}, job {cycle}, at {now}: {what}, {place}"),
        }?;
        self.last_words.as_ref().map_or(Ok(()), |words| write!(f, "\n  last log line: {words}"))
    }
}

/// What a stop that is no call means.
pub fn describe(image: &Image<'_>, memory: &Memory, stop: &Stop) -> (String, Place) {
    let (what, rip) = match stop {
        Stop::Signal { number, code, address, registers } => {
            let trap = code_offset(image, registers.rip).and_then(|at| image.trap(at));
            let what = trap.map_or_else(
                || signal(memory, *number, *code, *address, registers.rip),
                |trap| trap.kind.words().to_owned(),
            );
            (what, registers.rip)
        }
        Stop::TimedOut(registers) => ("it did not end in time".into(), registers.rip),
        Stop::ForeignCall(registers) => {
            let what = "a call of another operating system (int 0x80 or sysenter)";
            // The instruction is before the place where it would go on.
            (what.into(), registers.rip.wrapping_sub(2))
        }
        Stop::Call(registers) => ("a call".into(), registers.rip.wrapping_sub(2)),
        Stop::Gone => {
            let place = Place::Words("nothing is known of the place".into());
            return ("its process is gone".into(), place);
        }
    };
    let called = match stop {
        // A jump to nowhere was most often a call: the caller is on the stack.
        Stop::Signal { registers, .. } if code_offset(image, rip).is_none() => {
            memory.get(registers.rsp, 8).and_then(|bytes| bytes.try_into().ok())
        }
        _ => None,
    };
    let caller = called.map(u64::from_le_bytes).filter(|&at| code_offset(image, at).is_some());
    let place = match caller {
        // The return address is after the call.
        Some(at) => {
            let (Place::Source(caller) | Place::Words(caller)) = place(image, at - 1);
            Place::Words(format!("called at {caller}"))
        }
        None => place(image, rip),
    };
    (what, place)
}

/// Where a call of the kernel was made: by a function of the runtime, which has nothing on the stack but perhaps its
/// caller's frame pointer, so that its return address is one of the two topmost words.
pub fn place_of_call(image: &Image<'_>, memory: &Memory, registers: &Registers) -> Place {
    let top =
        [0, 8].into_iter().filter_map(|above| memory.get(registers.rsp.wrapping_add(above), 8));
    let mut words = top.filter_map(|bytes| Some(u64::from_le_bytes(bytes.try_into().ok()?)));
    let caller = words.find(|&at| code_offset(image, at).is_some());
    place(image, caller.unwrap_or(registers.rip).wrapping_sub(1))
}

/// File and line of an instruction, or its address.
fn place(image: &Image<'_>, rip: u64) -> Place {
    let Some(at) = code_offset(image, rip) else {
        return Place::Words(format!("at {rip:#x}, which is not in the code"));
    };
    if let Some(place) = image.trap(at).and_then(|trap| trap.place) {
        return Place::Source(format!("{}:{}", place.file, place.line));
    }
    match image.line(at) {
        Some(line) => Place::Source(format!("{}:{}", line.file, line.line)),
        None => Place::Words(format!("at {rip:#x}; no line is known there")),
    }
}

fn code_offset(image: &Image<'_>, rip: u64) -> Option<CodeOffset> {
    let offset = rip.checked_sub(address::CODE)?;
    (offset < image.code().len() as u64).then_some(CodeOffset(offset as u32))
}

fn signal(memory: &Memory, number: c_int, code: c_int, at: u64, rip: u64) -> String {
    /// A signal of the kernel's own, without an address (asm-generic/siginfo.h).
    const SI_KERNEL: c_int = 0x80;
    match number {
        libc::SIGFPE => "division by zero, or a quotient that does not fit".into(),
        libc::SIGILL => "illegal instruction".into(),
        libc::SIGTRAP => "breakpoint or single-step trap".into(),
        libc::SIGBUS if code != SI_KERNEL => "unaligned access".into(),
        libc::SIGSEGV | libc::SIGBUS if code == SI_KERNEL => {
            "privileged instruction, unaligned vector access or impossible address".into()
        }
        libc::SIGSEGV if at == rip => match memory.region(at) {
            Some(_) => format!("jump to {at:#x}, which is data"),
            None if at < address::PAGE => format!("call of a null function pointer ({at:#x})"),
            None => format!("jump to {at:#x}, where nothing is"),
        },
        libc::SIGSEGV => match memory.region(at) {
            Some(region) if region.rights == Rights::Execute => format!("write to code at {at:#x}"),
            Some(_) => format!("write to read-only memory at {at:#x}{}", area(at)),
            None if at < address::PAGE => format!("null reference ({at:#x})"),
            None if in_stacks(at) => format!("stack overflow ({at:#x} is below the stack)"),
            None => format!("access to {at:#x}, where nothing is"),
        },
        other => format!("signal {other}"),
    }
}

fn area(at: u64) -> &'static str {
    match at {
        address::INPUT..address::OUTPUT => ", an input",
        address::TASK_INFORMATION.. => ", the task information",
        _ => "",
    }
}

fn in_stacks(at: u64) -> bool {
    let end = address::STACKS + u64::from(limit::TASKS) * address::STACK_SLOT;
    (address::STACKS..end).contains(&at)
}
