//! Copies, and the four functions that the compiler of Rust takes for granted.
//!
//! `rep movsb` and `rep stosb` are as fast as anything for long blocks on the machines that Takt runs on; short blocks
//! are copied in words, because starting `rep` costs tens of cycles.

use core::arch::asm;

const WORD: usize = 8;
/// From here on `rep` pays.
const LONG: usize = 256;

/// Copies `bytes` bytes. The two may overlap.
///
/// # Safety
/// `from` is readable and `to` writable for so many bytes.
pub unsafe extern "C" fn copy(to: *mut u8, from: *const u8, bytes: usize) {
    if bytes >= LONG && (to as usize).wrapping_sub(from as usize) >= bytes {
        // SAFETY: the caller's promise. A copy upwards does not read what it wrote, by the condition. The direction
        // flag is clear by the calling convention.
        unsafe {
            asm!("rep movsb", inout("rcx") bytes => _, inout("rdi") to => _, inout("rsi") from => _,
                options(nostack, preserves_flags));
        }
        return;
    }
    // SAFETY: all accesses are within the blocks, by the caller's promise and the bounds of the loops.
    unsafe {
        if (to as usize).wrapping_sub(from as usize) >= bytes {
            let mut at = 0;
            while at + WORD <= bytes {
                let word = from.add(at).cast::<u64>().read_unaligned();
                to.add(at).cast::<u64>().write_unaligned(word);
                at += WORD;
            }
            while at < bytes {
                to.add(at).write_volatile(from.add(at).read());
                at += 1;
            }
        } else {
            let mut left = bytes;
            while left >= WORD {
                left -= WORD;
                let word = from.add(left).cast::<u64>().read_unaligned();
                to.add(left).cast::<u64>().write_unaligned(word);
            }
            while left > 0 {
                left -= 1;
                to.add(left).write_volatile(from.add(left).read());
            }
        }
    }
}

/// Makes each byte that is not 0 a 1: what came from outside becomes values of BOOL.
///
/// # Safety
/// `at` is readable and writable for `count` bytes.
pub unsafe extern "C" fn booleans(at: *mut u8, count: usize) {
    for index in 0..count {
        // SAFETY: within the bytes that the caller promises.
        unsafe {
            let byte = at.add(index);
            byte.write(u8::from(byte.read() != 0));
        }
    }
}

/// Sets `bytes` bytes to zero.
///
/// # Safety
/// `to` is writable for so many bytes.
pub unsafe extern "C" fn zero(to: *mut u8, bytes: usize) {
    // SAFETY: the caller's promise; the direction flag is clear by the calling convention.
    unsafe {
        asm!("rep stosb", in("al") 0u8, inout("rcx") bytes => _, inout("rdi") to => _, options(nostack, preserves_flags));
    }
}
