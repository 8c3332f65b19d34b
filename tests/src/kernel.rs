//! The smallest kernel that a Linux partition can be given: it is silent, or asks for a restart, in
//! turns.
//!
//! A Linux needs seconds of the lab's time to boot. What is measured when a partition is started
//! again and again is Takt, which does the same for any kernel.

use std::fs;
use std::path::PathBuf;

use crate::scratch;

/// Where the ELF file's only segment lies, in memory and in the file.
const ADDRESS: u64 = 1 << 20;
const OFFSET: usize = 0x400;

/// Machine code, which begins in 64-bit mode. If the machine was not restarted for its silence, the
/// watchdog gets 100 ms, and nothing more is heard of this kernel. Otherwise it counts for some
/// milliseconds, and writes the value 1 to the reset register of the partition's ACPI tables.
const CODE: [u8; 41] = [
    0x66, 0xba, 0x1c, 0x06, // mov dx, 0x61c
    0xed, // in eax, dx
    0x85, 0xc0, // test eax, eax
    0x75, 0x0d, // jnz 2f
    0x66, 0xba, 0x10, 0x06, // mov dx, 0x610
    0xb8, 0x0a, 0x00, 0x00, 0x00, // mov eax, 10
    0xef, // out dx, eax
    0xf4, // 1: hlt
    0xeb, 0xfd, // jmp 1b
    0xb9, 0x40, 0x4b, 0x4c, 0x00, // 2: mov ecx, 5000000
    0xff, 0xc9, // 3: dec ecx
    0x75, 0xfc, // jnz 3b
    0x66, 0xba, 0x02, 0x06, // mov dx, 0x602
    0xb0, 0x01, // mov al, 1
    0xee, // out dx, al
    0xf4, // 4: hlt
    0xeb, 0xfd, // jmp 4b
];

/// Writes the kernel, and returns its path. It is for a partition with a watchdog.
#[must_use]
pub fn restarting_kernel() -> PathBuf {
    let path = scratch().join("restarting-kernel");
    // A run that packs the file at this moment must see the old or the new one.
    let new = path.with_extension("new");
    fs::write(&new, image()).expect("the kernel can be written");
    fs::rename(&new, &path).expect("the kernel can be renamed");
    path
}

/// An ELF file (System V ABI, "Object Files") with one segment, its code.
fn image() -> Vec<u8> {
    const HEADER: u64 = 64;
    const SEGMENT: u16 = 56;
    let mut image = vec![0; OFFSET];
    let mut put = |at: usize, bytes: &[u8]| image[at..at + bytes.len()].copy_from_slice(bytes);
    // 64 bits, little-endian, version 1.
    put(0, b"\x7fELF\x02\x01\x01");
    // An executable for x86-64, version 1.
    put(16, &2_u16.to_le_bytes());
    put(18, &62_u16.to_le_bytes());
    put(20, &1_u32.to_le_bytes());
    put(24, &ADDRESS.to_le_bytes());
    put(32, &HEADER.to_le_bytes());
    put(52, &(HEADER as u16).to_le_bytes());
    put(54, &SEGMENT.to_le_bytes());
    put(56, &1_u16.to_le_bytes());
    // To be loaded, readable and executable; offset, addresses, and lengths in file and memory.
    let lengths = CODE.len() as u64;
    put(64, &1_u32.to_le_bytes());
    put(68, &5_u32.to_le_bytes());
    for (at, value) in
        [(72, OFFSET as u64), (80, ADDRESS), (88, ADDRESS), (96, lengths), (104, lengths)]
    {
        put(at, &value.to_le_bytes());
    }
    image.extend(CODE);
    // Takt looks for a bzImage's mark, which is further back than this kernel is long.
    image.resize(2 * OFFSET, 0);
    image
}
