//! Stacks, each with a page below it that is not mapped.
//!
//! A control program that recurses without end must hit something that faults, not the variables
//! below its stack. And the fault must be taken on *another* stack, or it could not be reported:
//! hence one stack per kind of exception (the processor's interrupt stack table). They are
//! separate so that a fault while handling a fault, or a machine check at any time, does not
//! destroy the frame in use. It also keeps exceptions off the red zone that the precompiled `core`
//! uses below the stack pointer.

use takt_abi::memory::PAGE;

/// Number of exception stacks.
const KINDS: usize = 5;
const MAIN_BYTES: usize = 16 * PAGE as usize;
const EXCEPTION_BYTES: usize = 2 * PAGE as usize;

/// A stack and its guard page, which lies below because a stack grows down.
#[repr(C, align(4096))]
pub(crate) struct Stack<const BYTES: usize> {
    guard: [u8; PAGE as usize],
    bytes: [u8; BYTES],
}

impl<const BYTES: usize> Stack<BYTES> {
    const EMPTY: Self = Self { guard: [0; PAGE as usize], bytes: [0; BYTES] };
}

/// Everything that runs outside exceptions. Only the assembly of `boot` needs its name.
pub(crate) static mut MAIN: Stack<MAIN_BYTES> = Stack::EMPTY;
static mut EXCEPTIONS: [Stack<EXCEPTION_BYTES>; KINDS] = [const { Stack::EMPTY }; KINDS];

/// Bytes from the address of [`MAIN`] to the top of that stack.
pub(crate) const MAIN_TOP: usize = size_of::<Stack<MAIN_BYTES>>();

/// Exceptions that have a stack of their own; the discriminant is the index in the interrupt
/// stack table of the task state segment, which counts from 1.
#[derive(Clone, Copy)]
#[repr(u8)]
pub(crate) enum Kind {
    Ordinary = 1,
    PageFault = 2,
    DoubleFault = 3,
    NonMaskable = 4,
    MachineCheck = 5,
}

impl Kind {
    /// The stack on which an exception vector is handled.
    pub(crate) const fn of(vector: usize) -> Self {
        match vector {
            2 => Self::NonMaskable,
            8 => Self::DoubleFault,
            14 => Self::PageFault,
            18 => Self::MachineCheck,
            _ => Self::Ordinary,
        }
    }
}

/// Where each exception stack begins, in the order of [`Kind`].
pub(crate) fn exception_tops() -> [u64; KINDS] {
    exception_bases().map(|base| base + size_of::<Stack<EXCEPTION_BYTES>>() as u64)
}

/// The pages that must not be mapped.
pub(crate) fn guards() -> [u64; KINDS + 1] {
    let mut guards = [(&raw const MAIN) as u64; KINDS + 1];
    guards[1..].copy_from_slice(&exception_bases());
    guards
}

fn exception_bases() -> [u64; KINDS] {
    let first = (&raw const EXCEPTIONS) as u64;
    core::array::from_fn(|index| first + (index * size_of::<Stack<EXCEPTION_BYTES>>()) as u64)
}
