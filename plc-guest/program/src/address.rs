//! Where a program lies in its address space at ring 3. All programs lie at the same addresses.
//!
//! Fixed addresses spare the kernel a dynamic linker: the file's pages are mapped as they are. Each
//! program has page tables of its own, so programs do not meet.

use crate::{TaskId, TaskInformation, limit};

/// Size of a page, the unit of mapping and of access rights.
pub const PAGE: u64 = 4096;
/// The kernel's call page, readable and executable: the code to which `init` and the tasks return.
pub const CALL_PAGE: u64 = 0x3fff_f000;
/// The code: readable and executable. Constants follow on the next page, see [`constants`].
pub const CODE: u64 = 0x4000_0000;
/// The state: readable and writable.
pub const STATE: u64 = 0x5000_0000;
/// The slots of the stacks, one for each task, [`STACK_SLOT`] bytes each.
pub const STACKS: u64 = 0x6000_0000;
/// Size of the slot of one stack. The lowest page of each slot is never mapped: it is the guard.
pub const STACK_SLOT: u64 = 0x10_0000;
/// The input image `%I`: readable.
pub const INPUT: u64 = 0x6800_0000;
/// The output image `%Q`: readable and writable.
pub const OUTPUT: u64 = 0x6810_0000;
/// The markers `%M`: readable and writable.
pub const MARKER: u64 = 0x6820_0000;
/// The page with a [`TaskInformation`] for each task, see [`task_information`]: readable.
pub const TASK_INFORMATION: u64 = 0x6fff_f000;

/// Where the constants of a program with so many bytes of code begin.
#[must_use]
pub const fn constants(code_bytes: u32) -> u64 {
    CODE + pages(code_bytes as u64)
}

/// The end of the stack of this task: the address that its stack pointer starts below.
#[must_use]
pub const fn stack_end(task: TaskId) -> u64 {
    STACKS + (task.0 as u64 + 1) * STACK_SLOT
}

/// Where a task finds its [`TaskInformation`], or `init` where it is none. Tasks preempt each other, so each has its own
/// place: in the order of the tasks, and behind those of the most tasks that there can be that of `init`.
#[must_use]
pub const fn task_information(task: Option<TaskId>) -> u64 {
    let place = match task {
        Some(task) => task.0 as u64,
        None => limit::TASKS as u64,
    };
    TASK_INFORMATION + place * size_of::<TaskInformation>() as u64
}

/// `bytes`, rounded up to whole pages.
#[must_use]
pub const fn pages(bytes: u64) -> u64 {
    bytes.next_multiple_of(PAGE)
}

// The areas do not meet, whatever their sizes within the limits are.
const _: () = {
    assert!(CALL_PAGE + PAGE == CODE);
    assert!(CODE + (limit::CODE_BYTES + limit::CONSTANT_BYTES) as u64 <= STATE);
    assert!(STATE + limit::STATE_BYTES as u64 <= STACKS);
    assert!(STACKS + limit::TASKS as u64 * STACK_SLOT <= INPUT);
    assert!(INPUT + limit::PROCESS_IMAGE_BYTES as u64 <= OUTPUT);
    assert!(OUTPUT + limit::PROCESS_IMAGE_BYTES as u64 <= MARKER);
    assert!(MARKER + limit::PROCESS_IMAGE_BYTES as u64 <= TASK_INFORMATION);
    let information = (limit::TASKS as u64 + 1) * size_of::<TaskInformation>() as u64;
    assert!(information <= PAGE);
    assert!(limit::STACK_BYTES as u64 == STACK_SLOT - PAGE);
};
