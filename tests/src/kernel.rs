//! The smallest kernels that a Linux partition can be given.
//!
//! A Linux needs a second of the lab's time to boot, and says nothing of the errors that Takt knows. What
//! is looked at here is Takt, which does the same for any kernel.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

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
    let mut code = saying(b"hello\n");
    code.extend([0xf4]); // 1: hlt
    code.extend([0xeb, 0xfd]); // jmp 1b
    write("silent-kernel", &code)
}

/// Writes a kernel that takes one interrupt of its timer, masks the timer, and spins with interrupts on. Returns its path.
#[must_use]
pub fn deaf_kernel() -> PathBuf {
    write(
        "deaf-kernel",
        &[
            0x48, 0x8d, 0x25, 0x9e, 0x20, 0x00,
            0x00, // lea rsp, [rip + 0x209e]: 8 KiB behind this
            0x48, 0x8d, 0x3d, 0x97, 0x20, 0x00,
            0x00, // lea rdi, [rip + 0x2097]: the same, for the IDT
            0x48, 0x8d, 0x05, 0x77, 0x00, 0x00, 0x00, // lea rax, [rip + 2f]
            0x66, 0x89, 0x87, 0x00, 0x02, 0x00, 0x00, // mov [rdi + 0x200], ax: vector 32
            0x8c, 0x8f, 0x02, 0x02, 0x00, 0x00, // mov [rdi + 0x202], cs
            0x66, 0xc7, 0x87, 0x04, 0x02, 0x00, 0x00, 0x00,
            0x8e, // mov word [rdi + 0x204], 0x8e00
            0x48, 0xc1, 0xe8, 0x10, // shr rax, 16
            0x66, 0x89, 0x87, 0x06, 0x02, 0x00, 0x00, // mov [rdi + 0x206], ax
            0x48, 0xc1, 0xe8, 0x10, // shr rax, 16
            0x89, 0x87, 0x08, 0x02, 0x00, 0x00, // mov [rdi + 0x208], eax
            0x83, 0xa7, 0x0c, 0x02, 0x00, 0x00, 0x00, // and dword [rdi + 0x20c], 0
            0x57, // push rdi
            0x57, // push rdi
            0x66, 0xc7, 0x44, 0x24, 0x06, 0x0f, 0x02, // mov word [rsp + 6], 0x20f
            0x0f, 0x01, 0x5c, 0x24, 0x06, // lidt [rsp + 6]
            0xb9, 0x1b, 0x00, 0x00, 0x00, // mov ecx, 0x1b
            0x0f, 0x32, // rdmsr
            0x0d, 0x00, 0x0c, 0x00, 0x00, // or eax, 0xc00: the APIC in x2APIC mode
            0x0f, 0x30, // wrmsr
            0x31, 0xd2, // xor edx, edx
            0xb9, 0x0f, 0x08, 0x00, 0x00, // mov ecx, 0x80f
            0xb8, 0xff, 0x01, 0x00, 0x00, // mov eax, 0x1ff
            0x0f, 0x30, // wrmsr: on
            0xb9, 0x32, 0x08, 0x00, 0x00, // mov ecx, 0x832
            0xb8, 0x20, 0x00, 0x00, 0x00, // mov eax, 32
            0x0f, 0x30, // wrmsr: the timer's vector
            0xb9, 0x38, 0x08, 0x00, 0x00, // mov ecx, 0x838
            0xb8, 0xe8, 0x03, 0x00, 0x00, // mov eax, 1000
            0x0f, 0x30, // wrmsr: the timer's count
            0xfb, // sti
            0xeb, 0xfe, // 1: jmp 1b
            0xb9, 0x0b, 0x08, 0x00, 0x00, // 2: mov ecx, 0x80b
            0x31, 0xc0, // xor eax, eax
            0x31, 0xd2, // xor edx, edx
            0x0f, 0x30, // wrmsr: the end of the interrupt
            0xb9, 0x32, 0x08, 0x00, 0x00, // mov ecx, 0x832
            0xb8, 0x20, 0x00, 0x01, 0x00, // mov eax, 0x10020
            0x0f, 0x30, // wrmsr: the timer is masked
            0x48, 0xcf, // iretq
        ],
    )
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

/// Writes a kernel that aims at the releases of a PLC with a frame of 1 ms, and returns its path. It finds them by
/// the time that is taken from it, and sweeps over the last 60 us before the same moment of the next frame in
/// steps of 53 ns; with what is logged, over some us before the PLC's wake-up. Before that it tries to set its TSC
/// forward, so that its instants would mean others, and a timer of the board's. After a thousand writes of what is
/// logged it says "aimed".
#[must_use]
pub fn aiming_kernel(aim: Aim) -> PathBuf {
    let [lvt, register, from] = match aim {
        // The vector is 32. Bits 17 and 18 are the timer's mode.
        Aim::Deadline => [2 << 17 | 32, 0x6e0u32, 940_000],
        Aim::OneShot => [32, 0x838, 940_000],
        Aim::Periodic => [1 << 17 | 32, 0x838, 940_000],
        // AMD's first performance counter.
        Aim::Logged => [1 << 16, 0xc001_0004, 977_500],
    };
    let mut code = vec![
        0xb9, 0x1b, 0x00, 0x00, 0x00, // mov ecx, 0x1b
        0x0f, 0x32, // rdmsr
        0x0d, 0x00, 0x0c, 0x00, 0x00, // or eax, 0xc00: the APIC in x2APIC mode
        0x0f, 0x30, // wrmsr
        0xb9, 0x3b, 0x00, 0x00, 0x00, // mov ecx, 0x3b
        0xb8, 0xff, 0xff, 0x07, 0x00, // mov eax, 0x7ffff
        0x31, 0xd2, // xor edx, edx
        0x0f, 0x30, // wrmsr: the TSC
        0xb0, 0x30, // mov al, 0x30
        0xe6, 0x43, // out 0x43, al
        0xb0, 0x01, // mov al, 1
        0xe6, 0x40, // out 0x40, al
        0xe6, 0x40, // out 0x40, al: the board's timer
        0xb9, 0x3e, 0x08, 0x00, 0x00, // mov ecx, 0x83e
        0xb8, 0x0b, 0x00, 0x00, 0x00, // mov eax, 0xb
        0x31, 0xd2, // xor edx, edx
        0x0f, 0x30, // wrmsr: each count is one of the bus
        0xb9, 0x32, 0x08, 0x00, 0x00, // mov ecx, 0x832
        0xb8, // mov eax, lvt
    ];
    code.extend(lvt.to_le_bytes());
    code.extend([
        0x31, 0xd2, // xor edx, edx
        0x0f, 0x30, // wrmsr: the timer's mode
        0x31, 0xdb, // xor ebx, ebx
        0x45, 0x31, 0xc0, // xor r8d, r8d
        0x45, 0x31, 0xdb, // xor r11d, r11d
    ]);
    let again = code.len();
    code.extend([
        0x0f, 0x31, // 1: rdtsc
        0x48, 0xc1, 0xe2, 0x20, // shl rdx, 32
        0x48, 0x09, 0xd0, // or rax, rdx
        0x49, 0x89, 0xc1, // mov r9, rax
        0x4c, 0x29, 0xc0, // sub rax, r8
        0x4d, 0x89, 0xc8, // mov r8, r9
        0x48, 0x3d, 0xe0, 0x2e, 0x00, 0x00, // cmp rax, 12000: longer than an interrupt
        0x72, 0xe6, // jb 1b
        0x83, 0xc3, 0x35, // add ebx, 53
        0x81, 0xfb, 0x60, 0xea, 0x00, 0x00, // cmp ebx, 60000
        0x72, 0x02, // jb 2f
        0x31, 0xdb, // xor ebx, ebx
        0x48, 0x8d, 0x83, // 2: lea rax, [rbx + from]
    ]);
    code.extend(from.to_le_bytes());
    if matches!(aim, Aim::Deadline | Aim::Logged) {
        code.extend([0x4c, 0x01, 0xc8]); // add rax, r9
    }
    if aim == Aim::Logged {
        code.extend([
            0x49, 0x89, 0xc2, // mov r10, rax
            0x0f, 0x31, // 3: rdtsc
            0x48, 0xc1, 0xe2, 0x20, // shl rdx, 32
            0x48, 0x09, 0xd0, // or rax, rdx
            0x49, 0x89, 0xc0, // mov r8, rax: no window, however long the write takes
            0x4c, 0x39, 0xd0, // cmp rax, r10
            0x72, 0xef, // jb 3b
        ]);
    }
    code.extend([
        0x48, 0x89, 0xc2, // mov rdx, rax
        0x48, 0xc1, 0xea, 0x20, // shr rdx, 32
        0xb9, // mov ecx, register
    ]);
    code.extend(register.to_le_bytes());
    code.extend([0x0f, 0x30]); // wrmsr
    let back = |code: &mut Vec<u8>| {
        let distance = again as i32 - (code.len() as i32 + 4);
        code.extend(distance.to_le_bytes());
    };
    if aim == Aim::Logged {
        code.extend([
            0x41, 0xff, 0xc3, // inc r11d
            0x41, 0x81, 0xfb, 0xe8, 0x03, 0x00, 0x00, // cmp r11d, 1000
            0x0f, 0x85, // jne 1b
        ]);
        back(&mut code);
        code.extend(saying(b"aimed\n"));
    }
    code.push(0xe9); // jmp 1b
    back(&mut code);
    write(&format!("aiming-kernel-{aim:?}"), &code)
}

/// Writes a kernel that switches its local APIC off and on for ever, by both registers that can, and says "switching" after
/// a thousand times. Returns its path.
#[must_use]
pub fn switching_kernel() -> PathBuf {
    let mut code = vec![
        0xb9, 0x1b, 0x00, 0x00, 0x00, // mov ecx, 0x1b
        0x0f, 0x32, // rdmsr
        0x25, 0xff, 0xf3, 0xff, 0xff, // and eax, ~0xc00
        0x89, 0xc3, // mov ebx, eax: off
        0x89, 0xd6, // mov esi, edx
        0x31, 0xff, // xor edi, edi
    ];
    let again = code.len();
    let base = |code: &mut Vec<u8>, bits: u32| {
        code.extend([0x89, 0xd8, 0x0d]); // mov eax, ebx; or eax, bits
        code.extend(bits.to_le_bytes());
        code.extend([
            0x89, 0xf2, // mov edx, esi
            0xb9, 0x1b, 0x00, 0x00, 0x00, // mov ecx, 0x1b
            0x0f, 0x30, // wrmsr
        ]);
    };
    // The spurious-interrupt vector register of the x2APIC mode, with its bit 8.
    let software = |code: &mut Vec<u8>, value: u32| {
        code.push(0xb8); // mov eax, value
        code.extend(value.to_le_bytes());
        code.extend([
            0x31, 0xd2, // xor edx, edx
            0xb9, 0x0f, 0x08, 0x00, 0x00, // mov ecx, 0x80f
            0x0f, 0x30, // wrmsr
        ]);
    };
    // Off, on, and in the mode in which its registers are those of the processor.
    base(&mut code, 0);
    base(&mut code, 0x800);
    base(&mut code, 0xc00);
    software(&mut code, 0x1ff);
    software(&mut code, 0xff);
    software(&mut code, 0x1ff);
    code.extend([
        0xff, 0xc7, // inc edi
        0x81, 0xff, 0xe8, 0x03, 0x00, 0x00, // cmp edi, 1000
        0x0f, 0x85, // jne
    ]);
    let back = |code: &mut Vec<u8>| {
        let distance = again as i32 - (code.len() as i32 + 4);
        code.extend(distance.to_le_bytes());
    };
    back(&mut code);
    code.extend(saying(b"switching\n"));
    code.push(0xe9); // jmp
    back(&mut code);
    write("switching-kernel", &code)
}

/// With what [`aiming_kernel`] aims: a mode of its timer, or something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aim {
    /// An instant.
    Deadline,
    /// A count, once.
    OneShot,
    /// A count, again and again.
    Periodic,
    /// A write to a register that KVM does not have and would log.
    Logged,
}

/// Code that writes these letters to the serial port.
fn saying(letters: &[u8]) -> Vec<u8> {
    let mut code = vec![0x66, 0xba, 0xf8, 0x03]; // mov dx, 0x3f8
    for letter in letters {
        code.extend([0xb0, *letter, 0xee]); // mov al, letter; out dx, al
    }
    code
}

fn write(name: &str, code: &[u8]) -> PathBuf {
    static WRITTEN: AtomicU32 = AtomicU32::new(0);
    let path = scratch().join(name);
    // A run that packs the file at this moment must see the old or the new one, and two tests may write it at once.
    let new = path.with_extension(format!("new{}", WRITTEN.fetch_add(1, Ordering::Relaxed)));
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
