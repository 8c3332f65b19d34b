//! What the compiler expects to be there: memory functions, and somewhere to go when a program panics.

use core::arch::{asm, global_asm};
use core::fmt::{self, Write};
use core::panic::PanicInfo;

use crate::call::log;

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
    // The tool knows this name: a fault here is the program's own decision.
    ".section .text.takt_trap_user, \"ax\", @progbits",
    ".globl takt_trap_user",
    "takt_trap_user:",
    "ud2",
    ".text",
);

/// A line of the log in the making; what is longer is cut.
struct Line {
    bytes: [u8; 120],
    length: usize,
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let rest = &mut self.bytes[self.length..];
            if rest.len() < character.len_utf8() {
                return Err(fmt::Error);
            }
            self.length += character.encode_utf8(rest).len();
        }
        Ok(())
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let mut line = Line { bytes: [0; 120], length: 0 };
    let _ = match info.location() {
        Some(place) => write!(line, "{}:{}: {}", place.file(), place.line(), info.message()),
        None => write!(line, "{}", info.message()),
    };
    log(core::str::from_utf8(&line.bytes[..line.length]).unwrap_or_default());
    // SAFETY: goes to an illegal instruction, which ends the program.
    unsafe { asm!("jmp takt_trap_user", options(noreturn)) }
}
