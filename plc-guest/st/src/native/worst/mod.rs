//! The greatest number of instructions that a job can take, from the machine code.
//!
//! Cranelift says where its blocks of code begin and where they lead; the instructions of a block are counted by decoding
//! it. Each loop has a mark in its code, by which it is found in the source and its greatest number of rounds, if one is
//! known before the program runs. The longest path through all that is the bound. It is a number of instructions, not a
//! time, and counts no path as impossible that the conditions would exclude.

mod graph;

use std::collections::BTreeMap;

use cranelift_codegen::CompiledCode;
use cranelift_codegen::ir::DebugTag;
use iced_x86::{Decoder, DecoderOptions, Mnemonic};

use super::link::{Compiled, Symbol};
use super::{NativeError, Prepared, alias, prepared};
use crate::hir::{Location, Program};
use graph::{Block, Graph, LoopMark};

/// A loop of a routine, as it was lowered.
#[derive(Clone, Copy, Debug)]
pub struct Loop {
    /// How many rounds it makes at most, if that is known.
    pub rounds: Option<u64>,
    /// Where it begins.
    pub location: Location,
}

/// What a job of a task takes at most.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Worst {
    /// There is a bound.
    Bounded(Cost),
    /// These loops have none, in the order of their places.
    Unbounded(Vec<Location>),
}

/// What some code takes at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// Instructions of the program itself.
    pub instructions: u64,
    /// Calls of the runtime's functions, for strings, for copies and for reals such as SIN, whose instructions are not
    /// counted.
    pub runtime_calls: u64,
}

/// What Cranelift says of one routine's code, by offsets.
pub struct Flow {
    starts: Vec<u32>,
    edges: Vec<(u32, u32)>,
    marks: Vec<(u32, LoopMark)>,
    loops: Vec<Loop>,
}

impl Flow {
    /// Takes it from Cranelift's result.
    pub fn new(code: &CompiledCode, loops: Vec<Loop>) -> Flow {
        let tags = code.buffer.debug_tags().flat_map(|list| {
            let marks = list.tags.iter().filter_map(|tag| match tag {
                DebugTag::User(number) => Some(LoopMark(*number)),
                DebugTag::StackSlot(_) => None,
            });
            marks.map(move |mark| (list.offset, mark))
        });
        Flow {
            starts: code.bb_starts.clone(),
            edges: code.bb_edges.clone(),
            marks: tags.collect(),
            loops,
        }
    }
}

/// The blocks of a routine's code, with what is in them.
fn blocks(routine: &Compiled) -> Vec<Block> {
    let flow = &routine.flow;
    // The code that makes the frame is no block of Cranelift's.
    let mut starts = vec![0];
    starts.extend(flow.starts.iter().filter(|start| **start > 0));
    let ends = starts.iter().skip(1).copied().chain([routine.code.len() as u32]);
    let of_range = |(&start, end): (&u32, u32)| {
        let (instructions, end) = decoded(&routine.code[start as usize..end as usize], start);
        let mut block = Block { instructions, ..Block::default() };
        for relocation in &routine.relocations {
            match relocation.to {
                _ if !(start..end).contains(&relocation.offset) => {}
                Symbol::Routine(index) => block.calls.push(index),
                Symbol::Runtime(_) => block.runtime_calls += 1,
                Symbol::Constant(_) => {}
            }
        }
        block
    };
    let mut blocks: Vec<Block> = starts.iter().zip(ends).map(of_range).collect();
    if starts.len() > flow.starts.len() {
        blocks[0].next.insert(1);
    }
    let block_at = |offset: u32| starts.partition_point(|start| *start <= offset).saturating_sub(1);
    for (from, to) in &flow.edges {
        blocks[block_at(*from)].next.insert(block_at(*to));
    }
    for (offset, mark) in &flow.marks {
        blocks[block_at(*offset)].marks.push(*mark);
    }
    blocks
}

/// The instructions of a block, up to what leaves it, and where that is. Behind it lie tables and constants. What a
/// jump within the block skips, as conversions of reals have it, is counted.
fn decoded(bytes: &[u8], start: u32) -> (u64, u32) {
    let first = u64::from(start);
    // Jumps within a block lead forward. One to an address in a register has no target here.
    let within = first + 1..first + bytes.len() as u64;
    let mut decoder = Decoder::with_ip(64, bytes, first, DecoderOptions::NONE);
    let mut count = 0;
    while decoder.can_decode() {
        let instruction = decoder.decode();
        count += 1;
        let leaves = match instruction.mnemonic() {
            Mnemonic::Jmp => !within.contains(&instruction.near_branch_target()),
            Mnemonic::Ret | Mnemonic::Ud2 | Mnemonic::INVALID => true,
            _ => false,
        };
        if leaves {
            break;
        }
    }
    (count, decoder.ip() as u32)
}

/// What a job of each task takes at most, in the order of the tasks.
///
/// # Errors
/// See [`NativeError`].
pub fn worst(program: &Program) -> Result<Vec<Worst>, NativeError> {
    let Prepared { program, compiled, .. } = prepared(program)?;
    let mut known: BTreeMap<u32, Worst> = BTreeMap::new();
    for id in alias::callees_first(&program) {
        let worst = of_routine(&compiled[id.0 as usize], &known);
        known.insert(id.0, worst);
    }
    Ok(program.tasks.iter().map(|task| known[&task.entry.0].clone()).collect())
}

fn of_routine(routine: &Compiled, callees: &BTreeMap<u32, Worst>) -> Worst {
    let mut unbounded = Vec::new();
    let mut costs = Vec::new();
    let blocks = blocks(routine);
    for block in &blocks {
        let mut cost =
            Cost { instructions: block.instructions, runtime_calls: block.runtime_calls };
        for callee in &block.calls {
            match callees.get(callee) {
                Some(Worst::Bounded(of_callee)) => cost = cost.and(*of_callee),
                Some(Worst::Unbounded(loops)) => unbounded.extend(loops),
                None => unreachable!("callees come first"),
            }
        }
        costs.push(cost);
    }
    let rounds = |mark: Option<LoopMark>| match mark
        .map(|LoopMark(number)| routine.flow.loops[number as usize])
    {
        Some(Loop { rounds: Some(rounds), .. }) => Ok(rounds),
        Some(Loop { location, .. }) => Err(location),
        // Cranelift made no loop of its own in any program yet; if it does, it is not taken for bounded.
        None => Err(Location::default()),
    };
    let cost = Graph::new(&blocks, costs).longest(&rounds, &mut unbounded);
    if unbounded.is_empty() {
        return Worst::Bounded(cost);
    }
    unbounded.sort_unstable_by_key(|at| (at.file, at.line, at.column));
    unbounded.dedup();
    Worst::Unbounded(unbounded)
}

impl Cost {
    fn and(self, other: Cost) -> Cost {
        Cost {
            instructions: self.instructions.saturating_add(other.instructions),
            runtime_calls: self.runtime_calls.saturating_add(other.runtime_calls),
        }
    }

    fn times(self, rounds: u64) -> Cost {
        Cost {
            instructions: self.instructions.saturating_mul(rounds),
            runtime_calls: self.runtime_calls.saturating_mul(rounds),
        }
    }

    /// The greater of each.
    fn or(self, other: Cost) -> Cost {
        Cost {
            instructions: self.instructions.max(other.instructions),
            runtime_calls: self.runtime_calls.max(other.runtime_calls),
        }
    }
}
