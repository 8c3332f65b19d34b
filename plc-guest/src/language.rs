//! What compiled Rust expects to find without naming it: memory functions and a panic handler.
//!
//! The memory functions are string instructions: short, correct for every alignment, fast on the
//! processors in question, and they cannot be compiled into a call of themselves. They take eight bytes at a time: what
//! the kernel copies at a switch of tasks is a few words each. The guest is
//! built against the `core` of a hosted target, which expects them from a C library and also refers to an
//! unwinder that never runs here.

use crate::{console, port};
use core::arch::asm;
use core::panic::PanicInfo;

/// Bytes that a string instruction moves at once.
const WORD: usize = 8;
/// Exit code of a guest that panicked; the one Rust programs have everywhere.
const PANIC: u32 = 101;

#[panic_handler]
fn panic(information: &PanicInfo) -> ! {
    match information.location() {
        Some(place) => console::print(format_args!("panic at {}:{}", place.file(), place.line())),
        None => console::print(format_args!("panic")),
    }
    port::exit(PANIC)
}

#[unsafe(no_mangle)]
extern "C" fn rust_eh_personality() {}

/// # Safety
///
/// As in C.
#[unsafe(no_mangle)]
unsafe extern "C" fn memcpy(to: *mut u8, from: *const u8, bytes: usize) -> *mut u8 {
    // SAFETY: the caller promises that both ranges are valid and apart; the direction flag is
    // clear by the calling convention.
    unsafe {
        asm!(
            "rep movsq",
            "mov ecx, {rest:e}",
            "rep movsb",
            rest = in(reg) bytes % WORD,
            inout("rcx") bytes / WORD => _,
            inout("rdi") to => _,
            inout("rsi") from => _,
            options(nostack, preserves_flags),
        );
    }
    to
}

/// # Safety
///
/// As in C.
#[unsafe(no_mangle)]
unsafe extern "C" fn memmove(to: *mut u8, from: *const u8, bytes: usize) -> *mut u8 {
    // Also right when `to` is below `from`: the difference wraps to a large number.
    if (to as usize).wrapping_sub(from as usize) >= bytes {
        // SAFETY: the caller promises valid ranges, and an upward copy is right for these.
        return unsafe { memcpy(to, from, bytes) };
    }
    // SAFETY: `to` lies within the source, so the copy runs from the last byte down; `bytes` is
    // not 0 here, and the direction flag is restored.
    unsafe {
        asm!(
            "std",
            "rep movsb",
            "cld",
            inout("rcx") bytes => _,
            inout("rdi") to.add(bytes - 1) => _,
            inout("rsi") from.add(bytes - 1) => _,
            options(nostack),
        );
    }
    to
}

/// # Safety
///
/// As in C.
#[unsafe(no_mangle)]
unsafe extern "C" fn memset(to: *mut u8, value: i32, bytes: usize) -> *mut u8 {
    // SAFETY: the caller promises a valid range; only the low byte of the value counts.
    unsafe {
        asm!(
            "rep stosq",
            "mov ecx, {rest:e}",
            "rep stosb",
            rest = in(reg) bytes % WORD,
            inout("rcx") bytes / WORD => _,
            inout("rdi") to => _,
            in("rax") u64::from_ne_bytes([value as u8; WORD]),
            options(nostack, preserves_flags),
        );
    }
    to
}

/// # Safety
///
/// As in C.
#[unsafe(no_mangle)]
unsafe extern "C" fn memcmp(left: *const u8, right: *const u8, bytes: usize) -> i32 {
    for offset in 0..bytes {
        // SAFETY: the caller promises that both ranges are readable.
        let (a, b) = unsafe { (*left.add(offset), *right.add(offset)) };
        if a != b {
            return i32::from(a) - i32::from(b);
        }
    }
    0
}

/// # Safety
///
/// As in C.
#[unsafe(no_mangle)]
unsafe extern "C" fn bcmp(left: *const u8, right: *const u8, bytes: usize) -> i32 {
    // SAFETY: the contract is the same.
    unsafe { memcmp(left, right, bytes) }
}
