//! Processor exceptions: record, report, stop.
//!
//! A guest never repairs an exception of its own. Every one means that the control program is wrong, and
//! a wrong program must not go on controlling; what to do about it is the health monitor's table,
//! not the guest's. So the handler writes what the processor told it into the status page and
//! calls the host, which does not run the guest again. Registers are not saved.
//!
//! One of a program at ring 3 is that program's error only. A guest that runs such programs gives a
//! handler for it ([`set_user_handler`]). Non-maskable interrupts, double faults and machine checks
//! end the guest wherever they come from.

use crate::{pages, port};
use core::arch::{asm, naked_asm};
use core::sync::atomic::{AtomicU64, Ordering};
use takt_abi::{Exception, port::EXCEPTION};

/// Number of vectors that the architecture reserves for exceptions.
pub(crate) const VECTORS: usize = 32;

/// Entry point of each vector.
pub(crate) const STUBS: [extern "C" fn(); VECTORS] = [
    plain::<0>,
    plain::<1>,
    plain::<2>,
    plain::<3>,
    plain::<4>,
    plain::<5>,
    plain::<6>,
    plain::<7>,
    with_code::<8>,
    plain::<9>,
    with_code::<10>,
    with_code::<11>,
    with_code::<12>,
    with_code::<13>,
    with_code::<14>,
    plain::<15>,
    plain::<16>,
    with_code::<17>,
    plain::<18>,
    plain::<19>,
    plain::<20>,
    with_code::<21>,
    plain::<22>,
    plain::<23>,
    plain::<24>,
    plain::<25>,
    plain::<26>,
    plain::<27>,
    plain::<28>,
    with_code::<29>,
    with_code::<30>,
    plain::<31>,
];

/// What lies on the exception stack when a handler begins: two words of the stubs, then the frame of
/// the processor.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Vector, 0 to 31.
    pub vector: u64,
    /// Error code, 0 where there is none.
    pub error_code: u64,
    /// Interrupted instruction.
    pub rip: u64,
    /// Code segment; its lowest two bits are the ring.
    pub cs: u64,
    /// Flags.
    pub rflags: u64,
    /// Stack pointer.
    pub rsp: u64,
    /// Stack segment.
    pub ss: u64,
}

/// Takes an exception of ring 3, on the exception's stack. It must not return.
pub type UserHandler = unsafe extern "C" fn(&Frame) -> !;

/// [`UserHandler`] as an address; 0: there is none.
static USER_HANDLER: AtomicU64 = AtomicU64::new(0);

/// Sets what becomes of exceptions of ring 3.
pub fn set_user_handler(handler: UserHandler) {
    USER_HANDLER.store(handler as usize as u64, Ordering::Relaxed);
}

/// Vectors that are not the interrupted program's doing: non-maskable interrupt, double fault, machine
/// check.
const FATAL: u64 = 1 << 2 | 1 << 8 | 1 << 18;

/// A vector for which the processor pushes no error code.
#[unsafe(naked)]
extern "C" fn plain<const VECTOR: u8>() {
    naked_asm!(
        "push 0",
        "push {vector}",
        "jmp {common}",
        vector = const VECTOR,
        common = sym common,
    )
}

/// A vector for which it does.
#[unsafe(naked)]
extern "C" fn with_code<const VECTOR: u8>() {
    naked_asm!("push {vector}", "jmp {common}", vector = const VECTOR, common = sym common)
}

/// Makes the interrupted program's state fit to call Rust: flags, frame chain, stack alignment.
#[unsafe(naked)]
extern "C" fn common() {
    naked_asm!(
        "cld",
        "mov rdi, rsp",
        "xor ebp, ebp",
        "and rsp, -16",
        "test byte ptr [rdi + {cs}], 3",
        "jz 2f",
        "mov ecx, [rdi]",
        "mov eax, {fatal}",
        "bt eax, ecx",
        "jc 2f",
        "mov rax, [rip + {user}]",
        "test rax, rax",
        "jz 2f",
        "call rax",
        "2:",
        "call {report}",
        cs = const core::mem::offset_of!(Frame, cs),
        fatal = const FATAL,
        user = sym USER_HANDLER,
        report = sym report,
    )
}

extern "C" fn report(frame: &Frame) -> ! {
    let cr2: u64;
    // SAFETY: reading the fault address has no effect, and this is ring 0.
    unsafe { asm!("mov {}, cr2", out(reg) cr2, options(nomem, nostack, preserves_flags)) };
    pages::publish_exception(Exception {
        vector: frame.vector,
        error_code: frame.error_code,
        rip: frame.rip,
        rsp: frame.rsp,
        rflags: frame.rflags,
        cr2,
    });
    loop {
        port::write(EXCEPTION, 0);
    }
}
