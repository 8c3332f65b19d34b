//! The ports of devices that the partition file gives to this guest.
//!
//! Each access is one VM exit, and is then made on the device exactly as it was made here. A port
//! that is not given reads as all ones and takes nothing; the host counts the attempt. So any port
//! may be tried, and these functions are safe: none can reach this guest's memory behind its back.
//! The guest's own calls to Takt are in [`port`](crate::port).

use core::arch::asm;

/// Reads a byte.
#[must_use]
pub fn inb(port: u16) -> u8 {
    let value: u8;
    // SAFETY: the host makes or refuses the access, outside this guest's memory. What was stored
    // before may be meant for a device, so `nomem` is absent.
    unsafe { asm!("in al, dx", in("dx") port, out("al") value, options(nostack, preserves_flags)) };
    value
}

/// Reads 16 bits.
#[must_use]
pub fn inw(port: u16) -> u16 {
    let value: u16;
    // SAFETY: as for `inb`.
    unsafe { asm!("in ax, dx", in("dx") port, out("ax") value, options(nostack, preserves_flags)) };
    value
}

/// Reads 32 bits.
#[must_use]
pub fn inl(port: u16) -> u32 {
    let value: u32;
    // SAFETY: as for `inb`.
    unsafe {
        asm!("in eax, dx", in("dx") port, out("eax") value, options(nostack, preserves_flags))
    };
    value
}

/// Writes a byte.
pub fn outb(port: u16, value: u8) {
    // SAFETY: as for `inb`.
    unsafe { asm!("out dx, al", in("dx") port, in("al") value, options(nostack, preserves_flags)) };
}

/// Writes 16 bits.
pub fn outw(port: u16, value: u16) {
    // SAFETY: as for `inb`.
    unsafe { asm!("out dx, ax", in("dx") port, in("ax") value, options(nostack, preserves_flags)) };
}

/// Writes 32 bits.
pub fn outl(port: u16, value: u32) {
    // SAFETY: as for `inb`.
    unsafe {
        asm!("out dx, eax", in("dx") port, in("eax") value, options(nostack, preserves_flags))
    };
}

/// Fills `bytes` from one port, a byte at a time, with one string instruction. The host takes
/// many bytes with one exit.
pub fn read_bytes(port: u16, bytes: &mut [u8]) {
    // SAFETY: the instruction writes `bytes.len()` bytes from the start of `bytes` upwards (the
    // direction flag is clear in compiled code), as the host hands them over.
    unsafe {
        asm!(
            "rep insb",
            in("dx") port,
            inout("rcx") bytes.len() => _,
            inout("rdi") bytes.as_mut_ptr() => _,
            options(nostack, preserves_flags),
        );
    }
}

/// Writes `bytes` to one port, a byte at a time, with one string instruction.
pub fn write_bytes(port: u16, bytes: &[u8]) {
    // SAFETY: the instruction only reads `bytes`, from its start upwards.
    unsafe {
        asm!(
            "rep outsb",
            in("dx") port,
            inout("rcx") bytes.len() => _,
            inout("rsi") bytes.as_ptr() => _,
            options(nostack, preserves_flags),
        );
    }
}
