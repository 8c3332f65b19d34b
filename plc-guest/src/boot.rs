//! From the first instruction to the main function.
//!
//! The VMM hands over a vCPU in long mode on tables of its own below the image. Nothing of that is
//! kept: first a stack and the control bits without which compiled code may not run, then gates and
//! page tables of the guest's own, and only then a look at what the host says. From that order
//! follows that everything beyond the first few dozen instructions can report its own failure.

use crate::paging::{Layout, Tables};
use crate::{channel, console, descriptor, pages, port, stack};
use core::arch::{asm, naked_asm};
use takt_abi::{Information, MAGIC, VERSION};

/// Exit code of a guest that does not know the interface it is offered.
const WRONG_INTERFACE: u32 = 1;

/// CR0: an exception for x87 errors instead of an external interrupt, FPU instructions
/// monitored, and write protection in force in ring 0 as well.
const CR0_SET: u64 = 1 << 16 | 1 << 5 | 1 << 1;
/// CR0: no emulation of the FPU and no lazy switching of its state.
const CR0_CLEAR: u64 = 1 << 3 | 1 << 2;
/// CR4: SSE, and an exception for its errors.
const CR4_SET: u64 = 1 << 10 | 1 << 9;
/// Extended feature register: its number, and the bit that makes "no execute" valid.
const EFER: u32 = 0xc000_0080;
const EFER_SET: u32 = 1 << 11;

static mut TABLES: Tables = Tables::empty();

unsafe extern "Rust" {
    /// Defined by [`entry!`](crate::entry).
    safe fn takt_guest_main() -> !;
}

unsafe extern "C" {
    // Addresses from `link.ld`; there is nothing to read at them.
    static __text_start: u8;
    static __text_end: u8;
    static __rodata_end: u8;
    static __data_end: u8;
}

/// The entry point of the image. `rdi` holds the address of the information page, which is a
/// constant of the interface and therefore not kept.
#[unsafe(naked)]
#[unsafe(no_mangle)]
extern "C" fn _start() -> ! {
    naked_asm!(
        "cli",
        "cld",
        "lea rsp, [rip + {stack} + {top}]",
        "xor ebp, ebp",
        "mov rax, cr0",
        "and rax, {cr0_keep}",
        "or rax, {cr0_set}",
        "mov cr0, rax",
        "mov rax, cr4",
        "or rax, {cr4_set}",
        "mov cr4, rax",
        "mov ecx, {efer}",
        "rdmsr",
        "or eax, {efer_set}",
        "wrmsr",
        "call {start}",
        stack = sym stack::MAIN,
        top = const stack::MAIN_TOP,
        cr0_keep = const !CR0_CLEAR as i64,
        cr0_set = const CR0_SET,
        cr4_set = const CR4_SET,
        efer = const EFER,
        efer_set = const EFER_SET,
        start = sym start,
    )
}

extern "C" fn start() -> ! {
    // SAFETY: `_start` runs once and calls this once, in ring 0.
    unsafe {
        descriptor::install();
        protect();
    }
    check(&pages::information());
    takt_guest_main()
}

/// Switches to the guest's own page tables.
///
/// # Safety
///
/// To be called once, with nothing outside the image in use any more.
unsafe fn protect() {
    let text_end = (&raw const __text_end) as u64;
    let rodata_end = (&raw const __rodata_end) as u64;
    let layout = Layout {
        text: (&raw const __text_start) as u64..text_end,
        rodata: text_end..rodata_end,
        data: rodata_end..(&raw const __data_end) as u64,
        guards: &stack::guards(),
        ports: channel::ports(),
    };
    let tables = &raw mut TABLES;
    // SAFETY: the caller promises the only call; from here on only the processor uses the tables.
    let root = unsafe { (*tables).build(&layout) };
    // SAFETY: the tables map the whole image to itself: the next instruction, the stack and all
    // data stay where they are.
    unsafe { asm!("mov cr3, {}", in(reg) root, options(nostack, preserves_flags)) };
}

fn check(information: &Information) {
    if information.magic != MAGIC || information.version != VERSION {
        console::print(format_args!(
            "this guest needs interface version {VERSION}, the host offers {} (magic {:#x})",
            information.version, information.magic
        ));
        port::exit(WRONG_INTERFACE);
    }
}
