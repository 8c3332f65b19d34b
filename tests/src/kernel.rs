//! The smallest kernels that a Linux partition can be given.
//!
//! A Linux needs a second of the lab's time to boot, and says nothing of the errors that Takt knows. What
//! is looked at here is Takt, which does the same for any kernel.

use std::fs;
use std::path::PathBuf;

use crate::scratch;

/// Where the ELF file's only segment lies, in memory and in the file.
const ADDRESS: u64 = 1 << 20;
const OFFSET: usize = 0x400;

/// Machine code, which begins in 64-bit mode. If the machine was not restarted for its silence, the
/// watchdog gets 100 ms, and nothing more is heard of this kernel. Otherwise it counts for some
/// milliseconds, and writes the value 1 to the reset register of the partition's ACPI tables.
const RESTARTING: [u8; 41] = [
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

/// What a kernel does that makes an error of this name; `None` if there is none.
fn erring(error: &str) -> Option<&'static [u8]> {
    Some(match error {
        "illegal-request" => &[
            0x66, 0xba, 0x00, 0x20, // mov dx, 0x2000
            0xed, // in eax, dx
        ],
        // An instruction where there is no memory: the host cannot execute it either.
        "hardware-fault" => &[
            0xb8, 0x00, 0x00, 0x00, 0xd0, // mov eax, 0xd0000000
            0xff, 0xe0, // jmp rax
        ],
        // There is no table of handlers.
        "processor-shutdown" => &[0x0f, 0x0b], // ud2
        // The reset register, the watchdog's time, and the register for sleeping, in all of which the
        // values are those of the partition's ACPI tables.
        "partition-reset" => &[
            0x66, 0xba, 0x02, 0x06, // mov dx, 0x602
            0xb0, 0x01, // mov al, 1
            0xee, // out dx, al
        ],
        "partition-silent" => &[
            0x66, 0xba, 0x10, 0x06, // mov dx, 0x610
            0xb8, 0x02, 0x00, 0x00, 0x00, // mov eax, 2
            0xef, // out dx, eax
        ],
        "partition-ended" => &[
            0x66, 0xba, 0x00, 0x06, // mov dx, 0x600
            0xb0, 0x34, // mov al, 0x34
            0xee, // out dx, al
        ],
        _ => return None,
    })
}

/// Writes a kernel that is silent or asks for a restart, in turns, and returns its path. It is for a
/// partition with a watchdog.
#[must_use]
pub fn restarting_kernel() -> PathBuf {
    write("restarting-kernel", &RESTARTING)
}

/// Writes a kernel that says "hello" on its serial port and halts with interrupts off, and returns its
/// path.
#[must_use]
pub fn silent_kernel() -> PathBuf {
    let mut code = vec![0x66, 0xba, 0xf8, 0x03]; // mov dx, 0x3f8
    for letter in b"hello\n" {
        code.extend([0xb0, *letter, 0xee]); // mov al, letter; out dx, al
    }
    code.extend([0xf4]); // 1: hlt
    code.extend([0xeb, 0xfd]); // jmp 1b
    write("silent-kernel", &code)
}

/// Writes a kernel that makes an error of the health monitor's list once it has counted down, which
/// takes two instructions for each `count`, and returns its path; `None` if it knows of no such error.
/// After an error that it survives it sleeps.
#[must_use]
pub fn erring_kernel(error: &str, count: u32) -> Option<PathBuf> {
    let mut code = vec![0xb9]; // mov ecx, count
    code.extend(count.to_le_bytes());
    code.extend([0xff, 0xc9]); // 1: dec ecx
    code.extend([0x75, 0xfc]); // jnz 1b
    code.extend(erring(error)?);
    code.extend([0xf4]); // 2: hlt
    code.extend([0xeb, 0xfd]); // jmp 2b
    Some(write(&format!("{error}-kernel-{count}"), &code))
}

fn write(name: &str, code: &[u8]) -> PathBuf {
    let path = scratch().join(name);
    // A run that packs the file at this moment must see the old or the new one.
    let new = path.with_extension("new");
    fs::write(&new, image(code)).expect("the kernel can be written");
    fs::rename(&new, &path).expect("the kernel can be renamed");
    path.canonicalize().expect("the kernel is there")
}

/// An ELF file (System V ABI, "Object Files") with one segment, its code.
fn image(code: &[u8]) -> Vec<u8> {
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
    let lengths = code.len() as u64;
    put(64, &1_u32.to_le_bytes());
    put(68, &5_u32.to_le_bytes());
    for (at, value) in
        [(72, OFFSET as u64), (80, ADDRESS), (88, ADDRESS), (96, lengths), (104, lengths)]
    {
        put(at, &value.to_le_bytes());
    }
    image.extend(code);
    // Takt looks for a bzImage's mark, which is further back than this kernel is long.
    image.resize(2 * OFFSET, 0);
    image
}
