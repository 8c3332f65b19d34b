//! What the compiler expects to be there: memory functions, and somewhere to go when a program panics. Nothing unwinds, but
//! parts of the library of Rust name the functions for it, as they were compiled for programs that do.

use core::arch::{asm, global_asm};
use core::panic::PanicInfo;

use crate::line::Line;

// `rep movsb` and `rep stosb` are as fast as any loop on processors of the last ten years (Intel's optimisation
// manual, "Enhanced REP MOVSB and STOSB"), and cannot be turned into a call of themselves by the compiler.
global_asm!(
    ".globl memcpy, memmove, memset, memcmp, bcmp",
    ".section .text.memcpy, \"ax\", @progbits",
    "memcpy:",
    "mov rax, rdi",
    "mov rcx, rdx",
    "rep movsb",
    "ret",
    ".section .text.memmove, \"ax\", @progbits",
    "memmove:",
    "mov rax, rdi",
    "mov rcx, rdx",
    "mov r8, rdi",
    "sub r8, rsi",
    "cmp r8, rdx",
    "jb 2f",
    "rep movsb",
    "ret",
    // The destination begins inside of the source: from the end on.
    "2:",
    "lea rdi, [rdi + rdx - 1]",
    "lea rsi, [rsi + rdx - 1]",
    "std",
    "rep movsb",
    "cld",
    "ret",
    ".section .text.memset, \"ax\", @progbits",
    "memset:",
    "mov r8, rdi",
    "mov eax, esi",
    "mov rcx, rdx",
    "rep stosb",
    "mov rax, r8",
    "ret",
    ".section .text.memcmp, \"ax\", @progbits",
    "memcmp:",
    "bcmp:",
    "xor eax, eax",
    "xor ecx, ecx",
    "2:",
    "cmp rcx, rdx",
    "je 3f",
    "movzx eax, byte ptr [rdi + rcx]",
    "movzx r8d, byte ptr [rsi + rcx]",
    "inc rcx",
    "sub eax, r8d",
    "je 2b",
    "3:",
    "ret",
    ".section .text.takt_unwind, \"ax\", @progbits",
    ".weak rust_eh_personality, _Unwind_Resume",
    "rust_eh_personality:",
    "_Unwind_Resume:",
    "jmp takt_trap_user",
    // The tool knows this name: a fault here is the program's own decision.
    ".section .text.takt_trap_user, \"ax\", @progbits",
    ".globl takt_trap_user",
    "takt_trap_user:",
    "ud2",
    ".text",
);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        Some(place) => {
            Line::log(format_args!("{}:{}: {}", place.file(), place.line(), info.message()));
        }
        None => Line::log(format_args!("{}", info.message())),
    }
    // SAFETY: goes to an illegal instruction, which ends the program.
    unsafe { asm!("jmp takt_trap_user", options(noreturn)) }
}
