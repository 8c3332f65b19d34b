//! Calls of the kernel.

use core::arch::asm;

/// Makes the call `number`. The kernel checks every argument, so none makes this unsound.
pub extern "C" fn call(number: u64, first: u64, second: u64, third: u64) -> i64 {
    let result;
    // SAFETY: the kernel keeps all registers but these, and writes no memory that the arguments do not name.
    unsafe {
        asm!("syscall", inout("rax") number => result, in("rdi") first, in("rsi") second,
            in("rdx") third, out("rcx") _, out("r11") _, options(nostack));
    }
    result
}
