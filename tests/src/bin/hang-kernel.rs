//! A Linux program that makes its kernel hang for good: nothing takes an interrupt any more, and the
//! processor is as busy as can be.
//!
//!     hang-kernel
//!
//! What a kernel does that waits for a lock with interrupts off is done here by another "kernel", of a
//! loop only, which this one loads and enters by kexec(2). It must come with interrupts
//! off, and so has them off for ever.
//!
//! Exit status 1: the kernel refuses.

use std::io::Error;
use std::process::ExitCode;

/// `struct kexec_segment` (kernel, `include/uapi/linux/kexec.h`).
#[repr(C)]
struct Segment {
    buffer: *const u8,
    buffer_len: usize,
    address: usize,
    len: usize,
}

const PAGE: usize = 4096;
/// Where the loop is put; any memory would do.
const ADDRESS: usize = 16 << 20;
/// `KEXEC_ARCH_X86_64`, of the same file.
const X86_64: usize = 62 << 16;

/// `nop` a hundred times, for an emulator's sake, and back to the first.
fn code() -> [u8; PAGE] {
    const NOP: u8 = 0x90;
    let mut code = [NOP; PAGE];
    // jmp -102
    code[100..102].copy_from_slice(&[0xeb, 0x9a]);
    code
}

fn main() -> ExitCode {
    let code = code();
    let segment = Segment { buffer: code.as_ptr(), buffer_len: PAGE, address: ADDRESS, len: PAGE };
    // SAFETY: the kernel reads the live segment and the page behind it.
    let loaded =
        unsafe { libc::syscall(libc::SYS_kexec_load, ADDRESS, 1, &raw const segment, X86_64) };
    if loaded == 0 {
        println!("hang-kernel: now");
        // SAFETY: ends everything that this machine does, which is what it is for.
        unsafe { libc::reboot(libc::LINUX_REBOOT_CMD_KEXEC) };
    }
    println!("hang-kernel: {}", Error::last_os_error());
    ExitCode::FAILURE
}
