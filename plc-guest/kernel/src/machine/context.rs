//! Between ring 0 and ring 3: how a task gets the processor, and how the kernel gets it back.
//!
//! [`run`] looks like a function: it returns when the task has entered the kernel again, and says why. So
//! the kernel is a loop in plain Rust, with one stack, and no entry of its own can nest: interrupts are off in
//! the whole kernel but for its last steps.
//!
//! A task's registers are saved into its [`Context`] with pushes: an entry's stack *is* the end of the
//! context, where the processor itself puts the interrupted program's frame. A call by which a job ends saves none of them, and
//! a job begins without a context to restore. Floating-point and SSE
//! registers are kept with FXSAVE at each entry, since compiled kernel code uses them too. AVX is not
//! available: CR4.OSXSAVE stays off, so its instructions, XGETBV and XSETBV are invalid.
//!
//! # Windows that begin in the kernel
//!
//! The host interrupts only who can be interrupted: for others the tick would be an exit, which costs more of the guard before a
//! release than the whole way through the kernel. So a window that begins while interrupts are off is for the kernel to find.
//! [`run`] looks for it with interrupts on, just before the task goes on: a window that begins before this look is found
//! by it, and one that begins behind it comes with a tick. A tick that comes there, in ring 0, leads back from [`run`] as the look does;
//! anywhere else in the kernel it has nothing to tell.
//!
//! # Traps of SYSCALL that are avoided
//!
//! - It does not change the stack. The entry's first instructions do; between them nothing can come,
//!   because interrupts are off (SFMASK) and exceptions have stacks of their own (IST).
//! - TF is in SFMASK, so a task that single-steps into the kernel takes its #DB at ring 3 afterwards; NT
//!   and AC are, so that neither reaches an `iretq` or an access of the kernel; DF and IF are.
//! - An interrupt or exception keeps AC, which would suspend SMAP: both set the kernel's own flags.
//! - SYSRET faults in ring 0 for an `rcx` that is not canonical (Intel), and takes flags from `r11`. The
//!   kernel returns with `iretq` from a frame of its own in every case: one way out for all entries.
//! - SWAPGS is not needed: the kernel has no data behind GS. CR4.FSGSBASE stays off, and both bases are
//!   zero for ever; a task can load null or its own data segment into FS and GS, which are flat.
//!
//! (AMD64 volume 2, section 6.1.1; Intel SDM volume 2, "SYSCALL" and "SYSRET".)

use core::arch::{asm, naked_asm};
use core::cell::UnsafeCell;
use core::mem::offset_of;
use core::ptr;
use takt_plc_guest::descriptor::{self, KERNEL_CODE, USER_CODE, USER_DATA};
use takt_plc_guest::exception::{self, Frame};
use takt_plc_guest::{interrupt, pages};
use takt_program::call::Call;

/// What a task is when it does not run.
///
/// The order is that of the pushes at an entry, from the end on.
#[repr(C, align(64))]
#[derive(Clone, Debug)]
pub struct Context {
    floating: [u8; 512],
    pub registers: Registers,
    /// 1 until its job has begun: the registers do not count.
    begins: u64,
}

/// The general registers, and the frame of an interrupt.
#[repr(C)]
#[derive(Clone, Debug)]
pub struct Registers {
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

/// Where the jobs of a task begin: with one argument, and nothing in the other registers.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Start {
    pub entry: u64,
    pub stack: u64,
    pub argument: u64,
}

/// Bytes to the end of the frame, without the padding.
const FRAME_END: u64 = offset_of!(Context, begins) as u64;
const _: () = assert!(FRAME_END.is_multiple_of(16), "the processor aligns the stack of ring 0");

/// Interrupts on, and the bit that is always set.
const FLAGS: u64 = 1 << 9 | 1 << 1;
/// Length of the instruction SYSCALL, behind which a task goes on after a call.
const SYSCALL_BYTES: u64 = 2;
/// Flags of the kernel: only the bit that is always set.
const KERNEL_FLAGS: u64 = 1 << 1;
/// State of the x87 unit and of SSE after a reset: all exceptions masked.
const X87_CONTROL: u8 = 0x7f;
const X87_CONTROL_HIGH: u8 = 0x03;
const MXCSR: u32 = 0x1f80;
/// The same, as a place that `ldmxcsr` can read.
static KERNEL_MXCSR: u32 = MXCSR;

#[repr(C, align(16))]
struct Image([u8; 512]);

/// The floating-point and SSE registers with which a job begins. A copy of it would take longer than the rest of a
/// job's beginning.
static CLEAN: Image = {
    let mut image = [0; 512];
    (image[0], image[1]) = (X87_CONTROL, X87_CONTROL_HIGH);
    [image[24], image[25], image[26], image[27]] = MXCSR.to_le_bytes();
    Image(image)
};

impl Registers {
    const EMPTY: Self = Self {
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
}

impl Context {
    /// Nothing.
    pub const EMPTY: Self = Self { floating: [0; 512], registers: Registers::EMPTY, begins: 0 };

    /// A job begins.
    pub fn begin(&mut self) {
        self.begins = 1;
    }

    /// After a call: the task makes it again, with the same number and arguments.
    pub fn repeat_call(&mut self) {
        self.registers.rip = self.registers.rip.wrapping_sub(SYSCALL_BYTES);
    }
}

/// Why the kernel has the processor again.
#[derive(Clone, Copy, Debug)]
pub enum Entry {
    /// A window has begun, or a device has interrupted.
    Tick,
    /// The task has made a call.
    Call,
    /// Its job is complete. Its registers are lost.
    End,
    /// It has caused an exception, and cannot go on: [`last_fault`].
    Fault,
}

/// An exception of ring 3.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// What lay on the stack.
    pub frame: Frame,
    /// Fault address register; meaningful for vector 14.
    pub cr2: u64,
}

const _: () = assert!(Call::End as u32 == 0, "`call` looks for it");

const TICK: u64 = 0;
const CALL: u64 = 1;
const END: u64 = 2;
const FAULT: u64 = 3;

/// What the entries need to find, with nothing in a register yet.
#[repr(C)]
struct Way {
    /// Stack of the kernel, as [`run`] left it.
    kernel: u64,
    /// End of the running task's context; after a call the task's stack.
    context: u64,
}

struct Shared<T>(UnsafeCell<T>);

// SAFETY: there is one thread, and interrupts are off whenever the kernel runs.
unsafe impl<T> Sync for Shared<T> {}

static WAY: Shared<Way> = Shared(UnsafeCell::new(Way { kernel: 0, context: 0 }));
static LAST_FAULT: Shared<Option<Fault>> = Shared(UnsafeCell::new(None));

/// Lets a task go on, or begin its job, until it enters the kernel again. If the release with this number is not that of the window any more, it
/// enters at once, as by a tick.
///
/// The tables of its program must be in use: what ring 3 does with wrong ones is undone by nothing.
#[inline]
pub fn run(context: &mut Context, start: &Start, release: u64) -> Entry {
    let end = ptr::from_mut(context) as u64 + FRAME_END;
    // SAFETY: one thread, interrupts off; the context is the stack of the entry, and stays until then.
    unsafe {
        (*WAY.0.get()).context = end;
        descriptor::set_ring_0_stack(end);
    }
    let entry: u64;
    // SAFETY: the context is one of ring 3 (only `begin` and entries write its frame), with flags that
    // keep no interrupt off. What `enter` and the task do not restore is told to the compiler.
    unsafe {
        asm!(
            "call {enter}",
            enter = sym enter,
            in("rdi") ptr::from_mut(context),
            in("rsi") release,
            in("rdx") ptr::from_ref(start),
            lateout("rax") entry,
            out("r12") _,
            out("r13") _,
            out("r14") _,
            out("r15") _,
            clobber_abi("C"),
        );
        match entry {
            TICK => Entry::Tick,
            CALL => Entry::Call,
            END => Entry::End,
            FAULT => Entry::Fault,
            // No entry leaves another number.
            _ => core::hint::unreachable_unchecked(),
        }
    }
}

/// What [`run`] has returned for, if that was an exception.
pub fn last_fault() -> Option<Fault> {
    // SAFETY: one thread; only the handler writes it, and ring 3 does not run.
    unsafe { *LAST_FAULT.0.get() }
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
    // A window that begins while a device's interrupt is noted brings no tick: interrupts are off then. So its handler does not go
    // back to the task either; the kernel looks for the window and lets it go on.
    // SAFETY: `tick` is the handler of an interrupt without an error code.
    unsafe { interrupt::return_by(tick) };
    // SAFETY: the caller promises ring 0.
    unsafe { super::processor::set_call_entry(call as *const () as u64, KERNEL_CODE) };
}

/// Restores all registers of the task whose context is in `rdi`, or sets those of its [`Start`] in `rdx`; returns at its next entry, with the kind of it in `rax`, or at once
/// if the release in `rsi` is not the window's. Of the registers it keeps `rbx`, `rbp` and `rsp`.
///
/// The frame goes to the kernel's stack, and each register comes from the context: a tick between `sti` and `iretq` leaves the
/// context as it was.
#[unsafe(naked)]
unsafe extern "C" fn enter() {
    naked_asm!(
        "push rbx",
        "push rbp",
        "mov [rip + {way} + {kernel}], rsp",
        "sti",
        ".globl takt_last_steps",
        "takt_last_steps:",
        "mov eax, {page}",
        "cmp rsi, [rax]",
        "jne 2f",
        "cmp qword ptr [rdi + {begins}], 0",
        "jne 3f",
        "fxrstor64 [rdi]",
        "push [rdi + {ss}]",
        "push [rdi + {rsp}]",
        "push [rdi + {rflags}]",
        "push [rdi + {cs}]",
        "push [rdi + {rip}]",
        ".set takt_at, {registers}",
        ".irp register, r15, r14, r13, r12, r11, r10, r9, r8, rbp",
        r"mov \register, [rdi + takt_at]",
        ".set takt_at, takt_at + 8",
        ".endr",
        ".irp register, rsi, rdx, rcx, rbx, rax",
        ".set takt_at, takt_at + 8",
        r"mov \register, [rdi + takt_at]",
        ".endr",
        "mov rdi, [rdi + {rdi}]",
        "iretq",
        // A job begins, with nothing in its registers.
        "3:",
        "fxrstor64 [rip + {clean}]",
        "push {user_data}",
        "push [rdx + {stack}]",
        "push {flags}",
        "push {user_code}",
        "push [rdx + {entry}]",
        "mov rdi, [rdx + {argument}]",
        ".irp register, eax, ebx, ecx, edx, esi, ebp, r8d, r9d, r10d, r11d, r12d, r13d, r14d, r15d",
        r"xor \register, \register",
        ".endr",
        "iretq",
        "2:",
        "cli",
        ".globl takt_last_steps_end",
        "takt_last_steps_end:",
        "mov eax, {kind}",
        "jmp takt_back",
        page = const pages::RELEASE,
        clean = sym CLEAN,
        user_data = const USER_DATA,
        user_code = const USER_CODE,
        flags = const FLAGS,
        stack = const offset_of!(Start, stack),
        entry = const offset_of!(Start, entry),
        argument = const offset_of!(Start, argument),
        begins = const offset_of!(Context, begins),
        kind = const TICK,
        way = sym WAY,
        kernel = const offset_of!(Way, kernel),
        registers = const offset_of!(Context, registers),
        ss = const offset_of!(Context, registers.ss),
        rsp = const offset_of!(Context, registers.rsp),
        rflags = const offset_of!(Context, registers.rflags),
        cs = const offset_of!(Context, registers.cs),
        rip = const offset_of!(Context, registers.rip),
        rdi = const offset_of!(Context, registers.rdi),
    )
}

/// A window has begun, or the interrupt of a device has been noted. What comes while the kernel runs, but for the end
/// of [`enter`], leads nowhere: the kernel looks for itself.
#[unsafe(naked)]
unsafe extern "C" fn tick() {
    naked_asm!(
        "push rax",
        "test byte ptr [rsp + 16], 3",
        "jz 2f",
        "push {flags}",
        "popfq",
        "mov eax, {kind}",
        "jmp takt_save",
        "2:",
        "lea rax, [rip + takt_last_steps]",
        "cmp [rsp + 8], rax",
        "jb 3f",
        "lea rax, [rip + takt_last_steps_end]",
        "cmp [rsp + 8], rax",
        "jae 3f",
        "mov eax, {kind}",
        "jmp takt_back",
        "3:",
        "pop rax",
        "iretq",
        kind = const TICK,
        flags = const KERNEL_FLAGS,
    )
}

/// A task makes a call. One by which a job ends saves nothing.
///
/// Behind it is how all entries from ring 3 save the rest of a context, whose frame and `rax` are saved, and return from [`enter`]
/// with what is in `rax`.
#[unsafe(naked)]
unsafe extern "C" fn call() {
    naked_asm!(
        "test rax, rax",
        "jz 2f",
        "xchg rsp, [rip + {way} + {context}]",
        "push {data}",
        // The task's stack.
        "push [rip + {way} + {context}]",
        "push r11",
        "push {code}",
        "push rcx",
        "push rax",
        "mov eax, {call}",
        ".globl takt_save",
        "takt_save:",
        ".irp register, rbx, rcx, rdx, rsi, rdi, rbp, r8, r9, r10, r11, r12, r13, r14, r15",
        r"push \register",
        ".endr",
        "fxsave64 [rsp - 512]",
        "mov qword ptr [rsp + {begins}], 0",
        ".globl takt_back",
        "takt_back:",
        "ldmxcsr [rip + {mxcsr}]",
        "mov rsp, [rip + {way} + {kernel}]",
        "pop rbp",
        "pop rbx",
        "ret",
        "2:",
        "mov eax, {end}",
        "jmp takt_back",
        way = sym WAY,
        context = const offset_of!(Way, context),
        kernel = const offset_of!(Way, kernel),
        begins = const offset_of!(Context, begins) - offset_of!(Context, registers),
        mxcsr = sym KERNEL_MXCSR,
        data = const USER_DATA,
        code = const USER_CODE,
        call = const CALL,
        end = const END,
    )
}

/// An exception of ring 3, on the exception's own stack. The task's registers are lost: it never goes
/// on.
unsafe extern "C" fn fault(frame: &Frame) -> ! {
    let cr2 = super::processor::fault_address();
    // SAFETY: one thread, and `last_fault` is not at work in ring 3.
    unsafe { *LAST_FAULT.0.get() = Some(Fault { frame: *frame, cr2 }) };
    // SAFETY: `run` is waiting, since ring 3 runs only then.
    unsafe { leave_fault() }
}

#[unsafe(naked)]
unsafe extern "C" fn leave_fault() -> ! {
    naked_asm!(
        "push {flags}",
        "popfq",
        "mov eax, {kind}",
        "jmp takt_back",
        flags = const KERNEL_FLAGS,
        kind = const FAULT,
    )
}
