//! From compiled routines to the bytes of a program: order, addresses, constants, traps.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use cranelift_codegen::FinalizedRelocTarget;
use cranelift_codegen::binemit::Reloc;
use cranelift_codegen::ir::{ExternalName, Function};

use super::lower::{CONSTANTS, ROUTINES, RUNTIME};
use super::runtime;
use super::target::address::CODE;
use super::trap::trap_kind;
use super::worst::{Flow, Loop};
use super::{Most, NativeError, TrapSite};
use crate::hir::{LocalKind, Location, Program, RoutineId, Task, Trap};

/// What is left of a routine when it has been compiled.
pub struct Compiled {
    pub code: Vec<u8>,
    pub alignment: u32,
    pub relocations: Vec<Relocation>,
    pub traps: Vec<(u32, Trap)>,
    /// Where the code of a source line begins.
    pub lines: Vec<(u32, Location)>,
    pub constants: Vec<Vec<u8>>,
    /// For the greatest number of its instructions.
    pub flow: Flow,
    /// Bytes of the frame, with the return address.
    pub frame: u32,
}

/// A place in a routine's code that holds the distance to something else.
pub struct Relocation {
    pub offset: u32,
    pub to: Symbol,
    pub addend: i64,
}

/// What a relocation refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symbol {
    Routine(u32),
    Runtime(u32),
    Constant(u32),
}

impl Compiled {
    /// Takes what is needed from Cranelift's result.
    pub fn new(
        function: &Function,
        code: &cranelift_codegen::CompiledCode,
        locations: &[Location],
        constants: Vec<Vec<u8>>,
        loops: Vec<Loop>,
    ) -> Compiled {
        let location = |at: u32| {
            let ranges = code.buffer.get_srclocs_sorted();
            // They do not overlap.
            let behind = ranges.partition_point(|range| range.start <= at);
            let found = ranges[..behind].last().filter(|range| at < range.end);
            let index = found.map_or(0, |range| range.loc.bits() as usize);
            index.checked_sub(1).and_then(|index| locations.get(index)).copied().unwrap_or_default()
        };
        let traps = code.buffer.traps().iter().filter_map(|trap| {
            let kind = trap_kind(trap.code)?;
            Some((trap.offset, Trap { kind, location: location(trap.offset) }))
        });
        let relocations = code.buffer.relocs().iter().map(|relocation| {
            // All names are within reach of a 32-bit distance from the code, and are called or their address is
            // computed.
            debug_assert!(
                matches!(relocation.kind, Reloc::X86CallPCRel4 | Reloc::X86PCRel4),
                "{:?}",
                relocation.kind
            );
            Relocation {
                offset: relocation.offset,
                to: symbol(function, &relocation.target),
                addend: relocation.addend,
            }
        });
        let lines = code.buffer.get_srclocs_sorted().iter().filter_map(|range| {
            let index = (range.loc.bits() as usize).checked_sub(1)?;
            Some((range.start, *locations.get(index)?))
        });
        Compiled {
            code: code.code_buffer().to_vec(),
            alignment: code.buffer.alignment.max(16),
            flow: Flow::new(code, loops),
            relocations: relocations.collect(),
            traps: traps.collect(),
            lines: lines.collect(),
            constants,
            frame: code.buffer.frame_layout().map_or(0, frame_bytes),
        }
    }
}

fn frame_bytes(layout: &cranelift_codegen::MachBufferFrameLayout) -> u32 {
    // From the stack pointer to the saved frame pointer, that, and the return address.
    layout.frame_to_fp_offset + 16
}

fn symbol(function: &Function, target: &FinalizedRelocTarget) -> Symbol {
    let name = match target {
        FinalizedRelocTarget::ExternalName(ExternalName::User(name)) => {
            &function.params.user_named_funcs()[*name]
        }
        other => unreachable!("Cranelift refers to {other:?}, which the lowering did not name"),
    };
    match name.namespace {
        ROUTINES => Symbol::Routine(name.index),
        RUNTIME => Symbol::Runtime(name.index),
        CONSTANTS => Symbol::Constant(name.index),
        other => unreachable!("there is no namespace {other}"),
    }
}

/// The program's bytes.
pub struct Linked {
    pub code: Vec<u8>,
    pub constants: Vec<u8>,
    pub routines: Vec<u32>,
    pub traps: Vec<TrapSite>,
    pub lines: Vec<(u32, Location)>,
}

const PAGE: usize = 4096;

/// Places the routines one behind the other in the order of their numbers.
pub fn link(program: &Program, compiled: &[Compiled]) -> Result<Linked, NativeError> {
    let uses_runtime = compiled
        .iter()
        .flat_map(|routine| &routine.relocations)
        .any(|relocation| matches!(relocation.to, Symbol::Runtime(_)));
    let mut code = if uses_runtime { runtime::IMAGE.to_vec() } else { Vec::new() };
    let mut routines = Vec::new();
    for routine in compiled {
        align(&mut code, routine.alignment as usize);
        routines.push(code.len() as u32);
        code.extend(&routine.code);
    }
    if code.len() > takt_program::limit::CODE_BYTES as usize {
        return Err(NativeError::TooMuch {
            what: "code",
            bytes: code.len(),
            limit: takt_program::limit::CODE_BYTES,
            most: most(program, compiled, |routine| routine.code.len()),
        });
    }

    let mut pool = Pool::default();
    let constants_at = CODE + code.len().next_multiple_of(PAGE) as u64;
    let (mut traps, mut lines) = (Vec::new(), Vec::new());
    for (routine, &start) in compiled.iter().zip(&routines) {
        for relocation in &routine.relocations {
            let target = match relocation.to {
                Symbol::Routine(index) => CODE + u64::from(routines[index as usize]),
                Symbol::Runtime(index) => CODE + u64::from(runtime::offset(index)),
                Symbol::Constant(index) => {
                    constants_at + u64::from(pool.add(&routine.constants[index as usize]))
                }
            };
            let at = (start + relocation.offset) as usize;
            // Both ends are within 32 MiB of each other.
            let distance =
                target.wrapping_add_signed(relocation.addend).wrapping_sub(CODE + at as u64) as u32;
            code[at..at + 4].copy_from_slice(&distance.to_le_bytes());
        }
        traps.extend(
            routine.traps.iter().map(|(at, trap)| TrapSite { offset: start + at, trap: *trap }),
        );
        lines.extend(routine.lines.iter().map(|(at, location)| (start + at, *location)));
    }
    if pool.bytes.len() > takt_program::limit::CONSTANT_BYTES as usize {
        return Err(NativeError::TooMuch {
            what: "constants",
            bytes: pool.bytes.len(),
            limit: takt_program::limit::CONSTANT_BYTES,
            most: most(program, compiled, |routine| routine.constants.iter().map(Vec::len).sum()),
        });
    }
    debug_assert_eq!(program.routines.len(), compiled.len());
    Ok(Linked { code, constants: pool.bytes, routines, traps, lines })
}

/// The routine with most of something.
fn most(program: &Program, compiled: &[Compiled], size: impl Fn(&Compiled) -> usize) -> Most {
    let routines = program.routines.iter().zip(compiled.iter().map(size));
    let found = routines.max_by_key(|(_, bytes)| *bytes);
    found.map_or_else(Most::default, |(routine, bytes)| Most {
        name: routine.name.clone(),
        bytes: bytes as u64,
        location: routine.location,
    })
}

/// Constants; equal ones are kept once.
#[derive(Default)]
struct Pool {
    bytes: Vec<u8>,
    known: HashMap<Vec<u8>, u32>,
}

impl Pool {
    fn add(&mut self, constant: &[u8]) -> u32 {
        if let Some(at) = self.known.get(constant) {
            return *at;
        }
        align(&mut self.bytes, 8);
        let at = self.bytes.len() as u32;
        self.bytes.extend(constant);
        // An empty string has an address too.
        if constant.is_empty() {
            self.bytes.push(0);
        }
        self.known.insert(constant.to_vec(), at);
        at
    }
}

fn align(bytes: &mut Vec<u8>, to: usize) {
    let length = bytes.len().next_multiple_of(to);
    bytes.resize(length, 0);
}

/// Bytes of stack that a call of each routine takes at most, with all that it calls. Calls form no cycle, so there is a
/// bound. The functions of the runtime get a fixed share.
pub fn stacks(program: &Program, compiled: &[Compiled]) -> BTreeMap<RoutineId, u32> {
    /// What the deepest function of the runtime takes, generously: the argument reduction of the sine has some 400
    /// bytes.
    const RUNTIME_STACK: u32 = 2048;
    let mut stacks: BTreeMap<RoutineId, u32> = BTreeMap::new();
    for id in super::alias::callees_first(program) {
        let routine = &compiled[id.0 as usize];
        let calls_runtime = routine
            .relocations
            .iter()
            .any(|relocation| matches!(relocation.to, Symbol::Runtime(_)));
        let below = super::alias::called(program, id)
            .iter()
            .filter_map(|callee| stacks.get(callee))
            .max()
            .copied();
        let deepest = below.unwrap_or(0).max(if calls_runtime { RUNTIME_STACK } else { 0 });
        stacks.insert(id, routine.frame.saturating_add(deepest));
    }
    stacks
}

/// Why a task has no room: of the routines that are called within each other, the one with the largest frame.
pub fn too_much_stack(
    program: &Program,
    compiled: &[Compiled],
    stacks: &BTreeMap<RoutineId, u32>,
    task: &Task,
) -> NativeError {
    let frame = |id: RoutineId| compiled[id.0 as usize].frame;
    let bytes = stacks[&task.entry];
    let (mut most, mut at) = (task.entry, task.entry);
    while let Some(callee) = super::alias::called(program, at)
        .into_iter()
        .max_by_key(|callee| stacks.get(callee).copied().unwrap_or(0))
    {
        at = callee;
        if frame(at) > frame(most) {
            most = at;
        }
    }
    let (most, variable) = largest(program, most, frame(most).into());
    NativeError::TooMuchStack {
        needing: format!("the task `{}`", task.name).into(),
        location: task.location,
        bytes: bytes.into(),
        most,
        variable,
    }
}

/// Why a routine has no room whose own frame is larger than any stack. It has not been compiled.
pub fn too_large_frame(program: &Program, id: RoutineId, bytes: u64) -> NativeError {
    let calls = |task: &&Task| {
        let (mut waiting, mut seen) = (vec![task.entry], BTreeSet::new());
        while let Some(next) = waiting.pop() {
            if seen.insert(next) {
                waiting.extend(super::alias::called(program, next));
            }
        }
        seen.contains(&id)
    };
    let (most, variable) = largest(program, id, bytes);
    let (needing, location) = match program.tasks.iter().find(calls) {
        Some(task) => (format!("the task `{}`", task.name), task.location),
        None => (format!("`{}`", most.name), most.location),
    };
    NativeError::TooMuchStack { needing: needing.into(), location, bytes, most, variable }
}

/// A routine that takes so many bytes of stack, with its largest variable there.
fn largest(program: &Program, id: RoutineId, bytes: u64) -> (Most, Option<(String, u32)>) {
    let routine = program.routine(id);
    let own = routine.locals.iter().filter(|local| local.kind != LocalKind::InOut);
    let own = own.map(|local| (local.name.clone(), program.types.size(local.ty)));
    let variable = own.filter(|(_, bytes)| *bytes > 0).max_by_key(|(_, bytes)| *bytes);
    (Most { name: routine.name.clone(), bytes, location: routine.location }, variable)
}
