//! Interrupts of devices: looked for by the program, never in its way.
//!
//! An interrupt that comes whenever its device likes makes every scan as long as its handlers. A
//! program that runs once in each window gains nothing from that: it acts on what it knows at the
//! start of its scan. So interrupts are off in this guest, and [`taken`] opens the door for one
//! instruction. What has arrived by then is noted, a bit for each vector; what comes later waits in
//! the interrupt controller, without a cost, for the next time.
//!
//! A device that goes on asking cannot make it longer either: after each interrupt the host keeps its
//! line closed until [`arm`].
//!
//! The handlers run on the stack of the program. Elsewhere that would damage what compiled code keeps
//! below its stack pointer (the "red zone"), but the only place in which an interrupt can happen is
//! an assembly block that the compiler has been told of.

use crate::{pages, port};
use core::arch::{asm, global_asm};
use core::sync::atomic::{AtomicBool, AtomicPtr, AtomicU64, Ordering};
use takt_abi::interrupt_controller::{LOCAL_APIC, SPURIOUS, VECTORS};
use takt_abi::port::ARM;

/// Vector of the first stub.
pub(crate) const FIRST: u8 = *VECTORS.start();
/// Model-specific register by which an interrupt is ended in x2APIC mode (Intel SDM volume 3,
/// "x2APIC Register Address Space").
const END_OF_INTERRUPT: u32 = 0x80b;
/// Bytes from one stub to the next.
const STUB_BYTES: u64 = 16;

/// What [`end_later`] has set.
static LATER: AtomicBool = AtomicBool::new(false);
/// Interrupts that are still to be ended.
static UNENDED: AtomicU64 = AtomicU64::new(0);

/// Vectors that have come and were not looked at, a bit for each.
static COME: [AtomicU64; 4] = [const { AtomicU64::new(0) }; 4];

/// Whether the interrupt with this vector has come since this was asked last.
///
/// It tells that the device has asked for attention at least once; what for, the device says. With
/// nothing to take this is a handful of instructions and no exit.
#[must_use]
pub fn taken(vector: u8) -> bool {
    open_for_a_moment();
    let bit = 1 << (vector % 64);
    let word = &COME[usize::from(vector / 64)];
    word.fetch_and(!bit, Ordering::Relaxed) & bit != 0
}

/// Lets the device with this vector interrupt, once. To be called when the program is ready for it,
/// and after each interrupt when the device has been served: one that still asks interrupts at once.
/// An exit, but not to Takt. Without an interrupt controller it does nothing.
pub fn arm(vector: u8) {
    if has_controller() {
        port::write(ARM, vector.into());
    }
}

/// Whether the partition file gives this guest any interrupt.
#[must_use]
pub fn has_controller() -> bool {
    pages::information().interrupt_controller == LOCAL_APIC
}

/// Has interrupts that come in ring 0 ended by [`end`]: for a guest that lets them in when it has no time for the exit that the
/// end costs. Until then no other comes with a vector of the same 16 or of lower ones.
pub fn end_later() {
    LATER.store(true, Ordering::Relaxed);
}

/// True if there is something to [`end`].
#[must_use]
#[inline]
pub fn is_unended() -> bool {
    UNENDED.load(Ordering::Relaxed) != 0
}

/// Ends what has come; an exit for each.
pub fn end() {
    for _ in 0..UNENDED.swap(0, Ordering::Relaxed) {
        // SAFETY: an interrupt has come, so this is ring 0 with a controller in x2APIC mode.
        unsafe {
            asm!("wrmsr", in("ecx") END_OF_INTERRUPT, in("eax") 0, in("edx") 0, options(nostack))
        };
    }
}

/// Takes what has arrived. `sti` itself keeps interrupts off for one more instruction.
pub fn open_for_a_moment() {
    // SAFETY: the handlers use the stack below, which `nostack` is absent for, keep all registers,
    // and write only `COME`. There is nothing to take in a machine without a controller.
    unsafe { asm!("sti", "nop", "cli") };
}

unsafe extern "C" {
    /// The first stub; the others follow.
    static takt_interrupt_stubs: u8;
    /// `iretq`.
    static takt_interrupt_return: u8;
}

/// Where the stubs go when an interrupt is noted.
static RETURN: AtomicPtr<u8> = AtomicPtr::new((&raw const takt_interrupt_return).cast_mut());

/// Has the stubs end in a handler of the guest's: for one that has more to do than to go on where it was.
///
/// # Safety
///
/// The handler finds all registers and the stack as the processor leaves them at an interrupt without an error code, and ends as
/// a handler of such a one does.
pub unsafe fn return_by(handler: unsafe extern "C" fn()) {
    RETURN.store(handler as *mut u8, Ordering::Relaxed);
}

/// The entry point of a vector, from [`FIRST`] on.
pub(crate) fn stub(vector: u8) -> u64 {
    (&raw const takt_interrupt_stubs) as u64 + u64::from(vector - FIRST) * STUB_BYTES
}

global_asm!(
    ".pushsection .text.takt_interrupts, \"ax\"",
    ".balign {stub_bytes}",
    // Its user may be compiled into another object.
    ".globl takt_interrupt_stubs",
    "takt_interrupt_stubs:",
    ".set takt_vector, {first}",
    ".rept {spurious} - {first}",
    "push takt_vector",
    "jmp 2f",
    ".balign {stub_bytes}",
    ".set takt_vector, takt_vector + 1",
    ".endr",
    // A spurious interrupt is none, and has no end to be told of.
    "jmp qword ptr [rip + {way}]",
    ".balign {stub_bytes}",
    // Ended before it is noted: it cannot come again before the door is open, and in the emulated
    // machine a vector that is noted twice is the same bit.
    "2:",
    "push rax",
    "push rcx",
    "push rdx",
    "test byte ptr [rsp + 40], 3",
    "jnz 3f",
    "cmp byte ptr [rip + {later}], 0",
    "je 3f",
    "lock inc qword ptr [rip + {unended}]",
    "jmp 4f",
    "3:",
    "mov ecx, {end}",
    "xor eax, eax",
    "xor edx, edx",
    "wrmsr",
    "4:",
    "mov eax, dword ptr [rsp + 24]",
    "lea rcx, [rip + {come}]",
    "lock bts qword ptr [rcx], rax",
    "pop rdx",
    "pop rcx",
    "pop rax",
    "add rsp, 8",
    "jmp qword ptr [rip + {way}]",
    ".globl takt_interrupt_return",
    "takt_interrupt_return:",
    "iretq",
    ".popsection",
    stub_bytes = const STUB_BYTES,
    first = const FIRST,
    spurious = const SPURIOUS,
    end = const END_OF_INTERRUPT,
    come = sym COME,
    later = sym LATER,
    unended = sym UNENDED,
    way = sym RETURN,
);
