//! Segments, task state and interrupt gates: what the processor needs to take an exception.
//!
//! The VMM's own descriptor table is below the image, where this guest maps nothing, and it has
//! neither a task state segment nor gates. Segmentation itself does nothing in long mode; the only
//! content here is which handler and which stack belong to which exception.
//!
//! A guest that runs programs at ring 3 also finds their segments here, and says where an entry from
//! there finds its stack. The order of the user's segments is the one that `syscall`'s register demands.
//!
//! Formats: AMD64 Architecture Programmer's Manual, volume 2, sections 4.8 and 12.2.5.

use crate::exception::{STUBS, VECTORS};
use crate::interrupt;
use crate::stack::{Kind, exception_tops};
use core::arch::asm;

const CODE: u16 = 8;
const DATA: u16 = 16;
const TASK: u16 = 24;
/// Code segment of ring 0, for `syscall`.
pub const KERNEL_CODE: u16 = CODE;
/// Data segment of ring 3, as a selector with that ring.
pub const USER_DATA: u16 = 40 | 3;
/// Code segment of ring 3, as a selector with that ring.
pub const USER_CODE: u16 = 48 | 3;

/// Present, ring 0, 64-bit code; already marked as accessed, so that the processor need not.
const CODE_DESCRIPTOR: u64 = 0x00af_9b00_0000_ffff;
const DATA_DESCRIPTOR: u64 = 0x00cf_9300_0000_ffff;
/// The same for ring 3.
const USER_DATA_DESCRIPTOR: u64 = 0x00cf_f300_0000_ffff;
const USER_CODE_DESCRIPTOR: u64 = 0x00af_fb00_0000_ffff;
/// Present, ring 0, available 64-bit task state segment.
const TASK_TYPE: u64 = 0x89;
/// Present, ring 0, 64-bit interrupt gate: it keeps interrupts off in the handler.
const GATE_TYPE: u64 = 0x8e;

/// The task state segment. The stack of ring 0 and the interrupt stack table are used.
#[repr(C, packed(4))]
struct TaskState {
    reserved_0: u32,
    privilege_stacks: [u64; 3],
    reserved_1: u64,
    interrupt_stacks: [u64; 7],
    reserved_2: [u16; 5],
    port_map: u16,
}

/// All vectors that there are.
const GATES: usize = 256;
/// No entry of the interrupt stack table: the handler runs where the program was.
const SAME_STACK: u64 = 0;

const TASK_BYTES: u16 = 104;
const _: () = assert!(size_of::<TaskState>() == TASK_BYTES as usize);

#[repr(C, align(16))]
struct Descriptors {
    segments: [u64; 7],
    gates: [[u64; 2]; GATES],
    task: TaskState,
}

static mut DESCRIPTORS: Descriptors = Descriptors {
    segments: [
        0,
        CODE_DESCRIPTOR,
        DATA_DESCRIPTOR,
        0,
        0,
        USER_DATA_DESCRIPTOR,
        USER_CODE_DESCRIPTOR,
    ],
    gates: [[0; 2]; GATES],
    task: TaskState {
        reserved_0: 0,
        privilege_stacks: [0; 3],
        reserved_1: 0,
        interrupt_stacks: [0; 7],
        reserved_2: [0; 5],
        // Beyond the limit: there is no map.
        port_map: TASK_BYTES,
    },
};

/// The operand of `lgdt` and `lidt`.
#[repr(C, packed)]
struct TableRegister {
    limit: u16,
    base: u64,
}

impl TableRegister {
    fn of<T>(table: &T) -> Self {
        Self {
            // Both tables are far smaller than 64 KiB.
            limit: (size_of::<T>() - 1) as u16,
            base: core::ptr::from_ref(table) as u64,
        }
    }
}

/// Fills the tables and makes the processor use them.
///
/// # Safety
///
/// To be called once, in ring 0 in long mode, before anything else refers to a segment register.
pub(crate) unsafe fn install() {
    let all = &raw mut DESCRIPTORS;
    // SAFETY: the caller promises the only call; from here on only the processor uses the tables.
    let all = unsafe { &mut *all };
    let mut stacks = [0; 7];
    let tops = exception_tops();
    stacks[..tops.len()].copy_from_slice(&tops);
    all.task.interrupt_stacks = stacks;
    let task = task_descriptor((&raw const all.task) as u64);
    all.segments[usize::from(TASK) / 8..][..task.len()].copy_from_slice(&task);
    for (vector, (slot, stub)) in all.gates.iter_mut().zip(STUBS).enumerate() {
        *slot = gate(stub as usize as u64, Kind::of(vector) as u64);
    }
    for (slot, vector) in all.gates.iter_mut().skip(VECTORS).zip(interrupt::FIRST..) {
        *slot = gate(interrupt::stub(vector), SAME_STACK);
    }
    let segments = TableRegister::of(&all.segments);
    let gates = TableRegister::of(&all.gates);
    // SAFETY: the tables are static and complete, the selectors name descriptors of the kind that
    // each register needs, and the far return goes to the next instruction.
    unsafe {
        asm!(
            "lgdt [{segments}]",
            "push {code}",
            "lea {scratch}, [rip + 2f]",
            "push {scratch}",
            "retfq",
            "2:",
            "mov ds, {data:x}",
            "mov es, {data:x}",
            "mov ss, {data:x}",
            "mov fs, {null:x}",
            "mov gs, {null:x}",
            "ltr {task:x}",
            "lidt [{gates}]",
            segments = in(reg) &raw const segments,
            gates = in(reg) &raw const gates,
            code = const CODE,
            data = in(reg) DATA,
            null = in(reg) 0_u16,
            task = in(reg) TASK,
            scratch = out(reg) _,
        );
    }
}

/// Makes `handler` the one of `vector`, on the stack of ring 0 if the interrupt comes from ring 3 and on the
/// same stack otherwise.
///
/// # Safety
///
/// `handler` must be one, which ends with `iretq` or never returns to where it came from.
pub unsafe fn set_gate(vector: u8, handler: unsafe extern "C" fn()) {
    let gate = gate(handler as usize as u64, SAME_STACK);
    // SAFETY: one thread, with interrupts off; only the processor reads it, at an interrupt.
    unsafe { DESCRIPTORS.gates[usize::from(vector)] = gate };
}

/// Where interrupts from ring 3 find their stack: below this address.
///
/// # Safety
///
/// There must be room for what a handler pushes, until this is called again.
pub unsafe fn set_ring_0_stack(top: u64) {
    // SAFETY: as in `set_gate`; the field is not aligned.
    unsafe {
        let stacks = &raw mut DESCRIPTORS.task.privilege_stacks;
        stacks.cast::<u64>().write_unaligned(top);
    }
}

const fn gate(handler: u64, stack: u64) -> [u64; 2] {
    let low = handler & 0xffff
        | (CODE as u64) << 16
        | stack << 32
        | GATE_TYPE << 40
        | (handler >> 16 & 0xffff) << 48;
    [low, handler >> 32]
}

const fn task_descriptor(base: u64) -> [u64; 2] {
    let low = (TASK_BYTES as u64 - 1)
        | (base & 0xff_ffff) << 16
        | TASK_TYPE << 40
        | (base >> 24 & 0xff) << 56;
    [low, base >> 32]
}
