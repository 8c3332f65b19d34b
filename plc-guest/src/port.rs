//! I/O ports: how a guest calls the host, and how a hostile one tries to reach hardware.
//!
//! Every access leaves the guest and ends in the VMM, which performs, refuses or acts on it. No
//! port can reach the guest's own memory behind its back, so these functions are safe to call.

use core::arch::asm;
use takt_abi::port;

/// Writes a 32-bit value.
pub fn write(port: u16, value: u32) {
    // SAFETY: the host handles the access outside this guest's memory. `nomem` is absent on
    // purpose: what was stored before must be in memory when the host looks.
    unsafe {
        asm!("out dx, eax", in("dx") port, in("eax") value, options(nostack, preserves_flags))
    };
}

/// Reads a 32-bit value.
#[must_use]
pub fn read(port: u16) -> u32 {
    let value: u32;
    // SAFETY: as for `write`.
    unsafe {
        asm!("in eax, dx", in("dx") port, out("eax") value, options(nostack, preserves_flags))
    };
    value
}

/// Ends this guest with an exit code; 0 is success.
pub fn exit(code: u32) -> ! {
    loop {
        write(port::EXIT, code);
    }
}
