//! Between ring 0 and ring 3: how a task gets the processor, and how the kernel gets it back.
//!
//! [`run`] looks like a function: it returns when the task has entered the kernel again, and says why. So
//! the kernel is a loop in plain Rust, with one stack, and no entry of its own can nest: interrupts are off in
//! the whole kernel.
//!
//! A task's registers are saved into its [`Context`] with pushes: an entry's stack *is* the end of the
//! context, where the processor itself puts the interrupted program's frame. Floating-point and SSE
//! registers are kept with FXSAVE at each entry, since compiled kernel code uses them too. AVX is not
//! available: CR4.OSXSAVE stays off, so its instructions, XGETBV and XSETBV are invalid.
//!
//! # Traps of SYSCALL that are avoided
//!
//! - It does not change the stack. The entry's first two instructions do; between them nothing can come,
//!   because interrupts are off (SFMASK) and exceptions have stacks of their own (IST).
//! - TF is in SFMASK, so a task that single-steps into the kernel takes its #DB at ring 3 afterwards; NT
//!   and AC are, so that neither reaches an `iretq` or an access of the kernel; DF and IF are.
//! - An interrupt or exception keeps AC, which would suspend SMAP: `back` sets the kernel's own flags for
//!   every entry.
//! - SYSRET faults in ring 0 for an `rcx` that is not canonical (Intel), and takes flags from `r11`. The
//!   kernel returns with `iretq` from a frame of its own in every case: one way out for all entries.
//! - SWAPGS is not needed: the kernel has no data behind GS. CR4.FSGSBASE stays off, and both bases are
//!   zero for ever; a task can load null or its own data segment into FS and GS, which are flat.
//!
//! (AMD64 volume 2, section 6.1.1; Intel SDM volume 2, "SYSCALL" and "SYSRET".)

use core::arch::naked_asm;
use core::cell::UnsafeCell;
use core::mem::offset_of;
use core::ptr;
use takt_plc_guest::descriptor::{self, KERNEL_CODE, USER_CODE, USER_DATA};
use takt_plc_guest::exception::{self, Frame};

/// What a task is when it does not run.
///
/// The order is that of the pushes at an entry, from the end on.
#[repr(C, align(64))]
#[derive(Clone, Debug)]
pub struct Context {
    floating: [u8; 512],
    r15: u64,
    r14: u64,
    r13: u64,
    r12: u64,
    r11: u64,
    pub r10: u64,
    r9: u64,
    r8: u64,
    rbp: u64,
    pub rdi: u64,
    pub rsi: u64,
    pub rdx: u64,
    rcx: u64,
    rbx: u64,
    pub rax: u64,
    rip: u64,
    cs: u64,
    rflags: u64,
    rsp: u64,
    ss: u64,
}

/// Bytes to the end of the frame, without the padding.
const FRAME_END: u64 = offset_of!(Context, ss) as u64 + 8;
const _: () = assert!(FRAME_END.is_multiple_of(16), "the processor aligns the stack of ring 0");

/// Interrupts on, and the bit that is always set.
const FLAGS: u64 = 1 << 9 | 1 << 1;
/// Length of the instruction SYSCALL, behind which a task goes on after a call.
const SYSCALL_BYTES: u64 = 2;
/// Flags of the kernel: only the bit that is always set.
const KERNEL_FLAGS: u64 = 1 << 1;
/// State of the x87 unit and of SSE after a reset: all exceptions masked.
const X87_CONTROL: u16 = 0x37f;
const MXCSR: u32 = 0x1f80;
/// The same, as a place that `ldmxcsr` can read.
static KERNEL_MXCSR: u32 = MXCSR;

impl Context {
    /// Nothing.
    pub const EMPTY: Self = Self {
        floating: [0; 512],
        r15: 0,
        r14: 0,
        r13: 0,
        r12: 0,
        r11: 0,
        r10: 0,
        r9: 0,
        r8: 0,
        rbp: 0,
        rdi: 0,
        rsi: 0,
        rdx: 0,
        rcx: 0,
        rbx: 0,
        rax: 0,
        rip: 0,
        cs: USER_CODE as u64,
        rflags: FLAGS,
        rsp: 0,
        ss: USER_DATA as u64,
    };

    /// The beginning of a job: at `entry` with one argument, and nothing in the other registers.
    pub fn begin(&mut self, entry: u64, stack: u64, argument: u64) {
        *self = Self::EMPTY;
        self.floating[..2].copy_from_slice(&X87_CONTROL.to_le_bytes());
        self.floating[24..28].copy_from_slice(&MXCSR.to_le_bytes());
        (self.rip, self.rsp, self.rdi) = (entry, stack, argument);
    }

    /// After a call: the task makes it again, with the same number and arguments.
    pub fn repeat_call(&mut self) {
        self.rip = self.rip.wrapping_sub(SYSCALL_BYTES);
    }
}

/// Why the kernel has the processor again.
#[derive(Clone, Copy, Debug)]
pub enum Entry {
    /// A window has begun.
    Tick,
    /// The task has made a call.
    Call,
    /// It has caused an exception, and cannot go on.
    Fault(Fault),
}

/// An exception of ring 3.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// What lay on the stack.
    pub frame: Frame,
    /// Fault address register; meaningful for vector 14.
    pub cr2: u64,
}

const TICK: u64 = 0;
const CALL: u64 = 1;
const FAULT: u64 = 2;

/// What the entries need to find, with nothing in a register yet.
#[repr(C)]
struct Way {
    /// Stack of the kernel, as [`run`] left it.
    kernel: u64,
    /// End of the running task's context.
    context: u64,
    /// Stack of the task, while a call is on its way in.
    user: u64,
}

struct Shared<T>(UnsafeCell<T>);

// SAFETY: there is one thread, and interrupts are off whenever the kernel runs.
unsafe impl<T> Sync for Shared<T> {}

static WAY: Shared<Way> = Shared(UnsafeCell::new(Way { kernel: 0, context: 0, user: 0 }));
static LAST_FAULT: Shared<Option<Fault>> = Shared(UnsafeCell::new(None));

/// Lets a task go on, until it enters the kernel again.
///
/// The tables of its program must be in use: what ring 3 does with wrong ones is undone by nothing.
pub fn run(context: &mut Context) -> Entry {
    let end = ptr::from_mut(context) as u64 + FRAME_END;
    // SAFETY: one thread, interrupts off; the context is the stack of the entry, and stays until then.
    unsafe {
        (*WAY.0.get()).context = end;
        descriptor::set_ring_0_stack(end);
    }
    // SAFETY: the context is one of ring 3 (only `begin` and entries write its frame), with flags that
    // keep no interrupt off.
    match unsafe { enter(context) } {
        TICK => Entry::Tick,
        CALL => Entry::Call,
        // SAFETY: one thread; the handler has written it.
        _ => match unsafe { (*LAST_FAULT.0.get()).take() } {
            Some(fault) => Entry::Fault(fault),
            None => unreachable!("an entry of no kind"),
        },
    }
}

/// Prepares the processor for entries from ring 3; `vector` is that of the interrupt at a window's start.
///
/// # Safety
///
/// To be called once, in ring 0, before [`run`].
pub unsafe fn install(vector: u8) {
    // SAFETY: the handler ends in `run`, or with `iretq`.
    unsafe { descriptor::set_gate(vector, tick) };
    exception::set_user_handler(fault);
    // SAFETY: the caller promises ring 0.
    unsafe { super::processor::set_call_entry(call as *const () as u64, KERNEL_CODE) };
}

/// Restores all registers of a task; returns at its next entry, with the kind of it.
#[unsafe(naked)]
unsafe extern "C" fn enter(context: *mut Context) -> u64 {
    naked_asm!(
        "push rbx",
        "push rbp",
        "push r12",
        "push r13",
        "push r14",
        "push r15",
        "mov [rip + {way} + {kernel}], rsp",
        "mov rsp, rdi",
        "fxrstor64 [rsp]",
        "add rsp, 512",
        "pop r15",
        "pop r14",
        "pop r13",
        "pop r12",
        "pop r11",
        "pop r10",
        "pop r9",
        "pop r8",
        "pop rbp",
        "pop rdi",
        "pop rsi",
        "pop rdx",
        "pop rcx",
        "pop rbx",
        "pop rax",
        "iretq",
        way = sym WAY,
        kernel = const offset_of!(Way, kernel),
    )
}

/// A window has begun. One that comes while the kernel runs is dropped: the kernel looks for itself.
#[unsafe(naked)]
unsafe extern "C" fn tick() {
    naked_asm!(
        "test byte ptr [rsp + 8], 3",
        "jz 2f",
        "push rax",
        "mov eax, {kind}",
        "jmp {save}",
        "2:",
        "iretq",
        kind = const TICK,
        save = sym save,
    )
}

/// A task makes a call.
#[unsafe(naked)]
unsafe extern "C" fn call() {
    naked_asm!(
        "mov [rip + {way} + {user}], rsp",
        "mov rsp, [rip + {way} + {context}]",
        "push {data}",
        "push [rip + {way} + {user}]",
        "push r11",
        "push {code}",
        "push rcx",
        "push rax",
        "mov eax, {kind}",
        "jmp {save}",
        way = sym WAY,
        user = const offset_of!(Way, user),
        context = const offset_of!(Way, context),
        data = const USER_DATA,
        code = const USER_CODE,
        kind = const CALL,
        save = sym save,
    )
}

/// Saves the rest of a context, whose frame and `rax` are saved, and returns from [`enter`] with what
/// is in `rax`.
#[unsafe(naked)]
unsafe extern "C" fn save() {
    naked_asm!(
        "push rbx",
        "push rcx",
        "push rdx",
        "push rsi",
        "push rdi",
        "push rbp",
        "push r8",
        "push r9",
        "push r10",
        "push r11",
        "push r12",
        "push r13",
        "push r14",
        "push r15",
        "fxsave64 [rsp - 512]",
        "jmp {back}",
        back = sym back,
    )
}

/// Back to the kernel's loop.
#[unsafe(naked)]
unsafe extern "C" fn back() {
    naked_asm!(
        "ldmxcsr [rip + {mxcsr}]",
        "mov rsp, [rip + {way} + {kernel}]",
        "push {flags}",
        "popfq",
        "pop r15",
        "pop r14",
        "pop r13",
        "pop r12",
        "pop rbp",
        "pop rbx",
        "ret",
        mxcsr = sym KERNEL_MXCSR,
        flags = const KERNEL_FLAGS,
        way = sym WAY,
        kernel = const offset_of!(Way, kernel),
    )
}

/// An exception of ring 3, on the exception's own stack. The task's registers are lost: it never goes
/// on.
unsafe extern "C" fn fault(frame: &Frame) -> ! {
    let cr2 = super::processor::fault_address();
    // SAFETY: one thread; `run` takes it before the next.
    unsafe { *LAST_FAULT.0.get() = Some(Fault { frame: *frame, cr2 }) };
    // SAFETY: `run` is waiting, since ring 3 runs only then.
    unsafe { leave_fault() }
}

#[unsafe(naked)]
unsafe extern "C" fn leave_fault() -> ! {
    naked_asm!("mov eax, {kind}", "jmp {back}", kind = const FAULT, back = sym back)
}
