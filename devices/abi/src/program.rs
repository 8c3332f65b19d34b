//! The program table: what a PLC partition that runs program images has of them in its memory.
//!
//! Takt reads and validates the images, and places them before the guest's first instruction; how an
//! image itself is built is the business of the crate `takt-program`. The guest learns from this table
//! alone where things lie. All addresses are guest-physical and multiples of
//! [`crate::memory::PAGE`], all areas are in RAM and do not overlap, and only the
//! images have been written to them since the start: the rest of each area is zero.
//!
//! The page is there if the partition has programs, and only then.

use crate::{MAGIC, VERSION, memory};

/// Most programs of a partition.
pub const PROGRAMS_MAX: usize = 16;
/// Most tasks of all programs of a partition, with one more for each program that has an initialisation.
pub const TASKS_MAX: usize = 64;
/// Most event tasks among them.
pub const EVENTS_MAX: usize = 32;
/// Most kernel objects of all programs of a partition.
pub const OBJECTS_MAX: usize = 255;
/// Longest name of a program, in bytes.
pub const NAME_BYTES: usize = 32;

/// What the guest has of its [working area](ProgramTable::work) for each program, apart from the stacks of its tasks,
/// [their views of the process image](view_bytes) and the messages of its objects: 64 KiB each for inputs, outputs and
/// markers, and the rest for page tables and the kernel's own records.
pub const WORK_BYTES_EACH: u64 = 768 << 10;

/// What the guest has of it for a queue, in bytes: each message with a header of 16 bytes, and one more.
#[must_use]
pub const fn queue_bytes(message_bytes: u32, depth: u32) -> u64 {
    (depth as u64 + 1) * message_area(message_bytes)
}

/// What the guest has of it for a mailbox, in bytes: three values with a header of 16 bytes each.
#[must_use]
pub const fn mailbox_bytes(bytes: u32) -> u64 {
    3 * message_area(bytes)
}

/// What the guest has of it for each task of a program with inputs or outputs of these lengths, in bytes: pages for
/// inputs and outputs of the task's own, for a map of the outputs that it writes, and for the page table of all these.
#[must_use]
pub const fn view_bytes(input_bytes: u32, output_bytes: u32) -> u64 {
    if input_bytes == 0 && output_bytes == 0 {
        return 0;
    }
    pages(input_bytes) + 2 * pages(output_bytes) + memory::PAGE
}

const fn pages(bytes: u32) -> u64 {
    (bytes as u64).next_multiple_of(memory::PAGE)
}

const fn message_area(bytes: u32) -> u64 {
    (bytes as u64).next_multiple_of(16) + 16
}

/// The programs of a partition. It lies at [`memory::PROGRAM_TABLE`], read-only.
///
/// All tasks of all programs are ranked together: by priority, 0 first; those of one priority by the place
/// of their program in this table; those of one program by their number. A task of a higher rank preempts
/// one of a lower rank. The analysis of `takt check` counts on this.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ProgramTable {
    /// [`MAGIC`].
    pub magic: u32,
    /// [`VERSION`].
    pub version: u32,
    /// How many of [`programs`](Self::programs) there are, at least one.
    pub count: u32,
    /// Zero.
    pub reserved: u32,
    /// Start of the memory behind all programs, which is the guest's to use: page tables, stacks,
    /// process images. It ends with the guest's RAM.
    pub work: u64,
    /// Its length: at least [`WORK_BYTES_EACH`] for each program, the stacks of all tasks, [`view_bytes`] for each
    /// of them, and [`queue_bytes`] and [`mailbox_bytes`] for all objects.
    pub work_bytes: u64,
    /// The programs, in the order of the partition file; the rest is zero.
    pub programs: [Program; PROGRAMS_MAX],
}

impl ProgramTable {
    /// No programs.
    pub const EMPTY: ProgramTable = ProgramTable {
        magic: MAGIC,
        version: VERSION,
        count: 0,
        reserved: 0,
        work: 0,
        work_bytes: 0,
        programs: [Program::NONE; PROGRAMS_MAX],
    };
}

/// One program.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Program {
    /// Its name in the partition, unique there, filled up with zeros.
    pub name: [u8; NAME_BYTES],
    /// Start of bank 0, at which the image begins.
    pub image: u64,
    /// Length of the image. It is valid as `takt-program` reads it.
    pub image_bytes: u64,
    /// Length of each bank, at least that of the image.
    pub bank_bytes: u64,
    /// Start of bank 1, which is empty.
    pub second_bank: u64,
    /// Start of the memory for the program's state.
    pub state: u64,
    /// Its length, at least what the image asks for.
    pub state_bytes: u64,
    /// Start of the block of its RETAIN and PERSISTENT variables: their values, one behind the other, in the order of
    /// the image's table.
    pub retained: u64,
    /// Length of the memory for it, at least that of the block.
    pub retained_bytes: u64,
    /// What follows from a fault of a task (an exception or a trap): [`action::STOP_PROGRAM`] or beyond.
    pub on_fault: u32,
    /// What follows when a job uses up its budget: one of [`action`].
    pub on_overrun: u32,
    /// What follows when a job is not complete at its deadline: one of [`action`].
    pub on_deadline: u32,
    /// What the block has at the guest's start: one of [`restored`].
    pub restored: u32,
    /// Start of the memory for the state of another version, as long as that of the first; 0 if there is none.
    pub second_state: u64,
}

impl Program {
    /// No program.
    pub const NONE: Program = Program {
        name: [0; NAME_BYTES],
        image: 0,
        image_bytes: 0,
        bank_bytes: 0,
        second_bank: 0,
        state: 0,
        state_bytes: 0,
        retained: 0,
        retained_bytes: 0,
        on_fault: 0,
        on_overrun: 0,
        on_deadline: 0,
        restored: restored::NOTHING,
        second_state: 0,
    };
}

/// What the block of retained variables has at the guest's start.
pub mod restored {
    /// Nothing: all variables get their initial values.
    pub const NOTHING: u32 = 0;
    /// Values of PERSISTENT variables, and initial ones of the others: the program's start is cold.
    pub const PERSISTENT: u32 = 1;
    /// Values of RETAIN variables too: the program's start is warm.
    pub const ALL: u32 = 2;
}

/// What follows from an error of a task. A greater number does more.
pub mod action {
    /// It is counted and told, and the job goes on.
    pub const LOG: u32 = 1;
    /// The job ends; the task goes on with its next release.
    pub const SKIP: u32 = 2;
    /// The program stops; its neighbours go on.
    pub const STOP_PROGRAM: u32 = 3;
    /// The program starts anew, warm: RETAIN and PERSISTENT variables keep their values. Its neighbours go on.
    pub const WARM_RESTART_PROGRAM: u32 = 4;
    /// The program starts anew, cold: only PERSISTENT variables keep their values. Its neighbours go on.
    pub const RESTART_PROGRAM: u32 = 5;
    /// The partition's guest ends itself, and the partition's own health table says what follows.
    pub const STOP_PARTITION: u32 = 6;
}

const _: () = {
    assert!(size_of::<Program>() == 120);
    assert!(size_of::<ProgramTable>() == 32 + PROGRAMS_MAX * 120);
    assert!(size_of::<ProgramTable>() as u64 <= memory::PAGE);
};
