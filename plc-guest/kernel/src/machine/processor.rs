//! Registers of the processor that the kernel sets, and that programs must not reach.

use core::arch::asm;
use core::arch::x86_64::__cpuid_count;

/// Extended feature register, with the bit for SYSCALL (AMD64 volume 2, section 3.1.7).
const EFER: u32 = 0xc000_0080;
const EFER_SYSCALL: u64 = 1;
/// Segments of SYSCALL and SYSRET, its entry, and the flags that it clears (section 6.1.1).
const STAR: u32 = 0xc000_0081;
const LSTAR: u32 = 0xc000_0082;
const SFMASK: u32 = 0xc000_0084;
/// Bases of FS and GS, and the one that SWAPGS would bring.
const BASES: [u32; 3] = [0xc000_0100, 0xc000_0101, 0xc000_0102];
/// TF, IF, DF, both bits of IOPL, NT, RF, AC.
const CLEARED: u64 = 1 << 8 | 1 << 9 | 1 << 10 | 3 << 12 | 1 << 14 | 1 << 16 | 1 << 18;

/// CR4: no user-mode SGDT and the like, no execution of ring 3's pages in ring 0, no access to them
/// there; each with its bit in leaf 7 of CPUID, sub-leaf 0: (bit, is it in ECX, bit there).
const PROTECTIONS: [(u32, bool, u32); 3] = [(11, true, 2), (20, false, 7), (21, false, 20)];
/// CR4: instructions of ring 3 for the time stamp counter stay; those for FS, GS, performance counters and
/// extended states go: FSGSBASE, PCE, OSXSAVE, PVI, VME, DE, TSD.
const CR4_CLEAR: u64 = 1 << 16 | 1 << 8 | 1 << 18 | 1 << 1 | 1 << 0 | 1 << 3 | 1 << 2;
/// CR0: alignment checks are as a program's flag says.
const CR0_ALIGNMENT: u64 = 1 << 18;

/// Closes what programs must not use, and opens what protects the kernel from itself.
///
/// # Safety
///
/// To be called in ring 0, before a program runs.
pub unsafe fn protect() {
    let features = __cpuid_count(7, 0);
    let offered = |(_, in_ecx, bit): &(u32, bool, u32)| {
        (if *in_ecx { features.ecx } else { features.ebx }) >> bit & 1 != 0
    };
    let set = PROTECTIONS.iter().filter(|p| offered(p)).fold(0, |set, p| set | 1u64 << p.0);
    // SAFETY: the caller promises ring 0; none of the bits changes what the kernel itself does.
    unsafe {
        let (cr0, cr4): (u64, u64);
        asm!("mov {}, cr0", out(reg) cr0, options(nomem, nostack, preserves_flags));
        asm!("mov {}, cr4", out(reg) cr4, options(nomem, nostack, preserves_flags));
        asm!("mov cr0, {}", in(reg) cr0 | CR0_ALIGNMENT, options(nostack, preserves_flags));
        asm!("mov cr4, {}", in(reg) cr4 & !CR4_CLEAR | set, options(nostack, preserves_flags));
        for base in BASES {
            write(base, 0);
        }
    }
}

/// Loads the segment registers that ring 3 can change and that no context keeps. In 64-bit mode their bases are zero
/// whatever is loaded, so this only takes a message from one program to another away.
pub fn forget_selectors() {
    // SAFETY: null is a valid selector for data in 64-bit mode, in ring 0 too (AMD64 volume 2, section 4.8.1).
    unsafe {
        asm!("mov ds, {0:e}", "mov es, {0:e}", "mov fs, {0:e}", "mov gs, {0:e}", in(reg) 0,
            options(nomem, nostack, preserves_flags));
    }
}

/// Sets where SYSCALL leads. The data segment of ring 0 follows the code segment.
///
/// # Safety
///
/// To be called in ring 0; `entry` must be an entry.
pub unsafe fn set_call_entry(entry: u64, code: u16) {
    // SAFETY: as the caller promises.
    unsafe {
        write(STAR, u64::from(code) << 32);
        write(LSTAR, entry);
        write(SFMASK, CLEARED);
        write(EFER, read(EFER) | EFER_SYSCALL);
    }
}

/// The address that the last page fault was about.
pub fn fault_address() -> u64 {
    let address: u64;
    // SAFETY: reading it has no effect, and this is ring 0.
    unsafe { asm!("mov {}, cr2", out(reg) address, options(nomem, nostack, preserves_flags)) };
    address
}

/// Waits until the time stamp counter has reached an instant of this window, and returns the time stamp that
/// ended the wait.
///
/// Five instructions, which are what a release may be late, without `pause` (`takt_plc_guest::cycle`
/// says why). A window that ends meanwhile ends the wait too, as time goes on without it.
pub fn wait_until(until: u64) -> u64 {
    let tsc: u64;
    // SAFETY: reading the counter has no effect.
    unsafe {
        asm!(
            "2:",
            "rdtsc",
            "shl rdx, 32",
            "or rax, rdx",
            "cmp rax, {until}",
            "jb 2b",
            until = in(reg) until,
            out("rax") tsc,
            out("rdx") _,
            options(nomem, nostack),
        );
    }
    tsc
}

unsafe fn read(register: u32) -> u64 {
    let (low, high): (u32, u32);
    // SAFETY: the caller names a register that there is, in ring 0.
    unsafe {
        asm!("rdmsr", in("ecx") register, out("eax") low, out("edx") high,
            options(nomem, nostack, preserves_flags));
    }
    u64::from(high) << 32 | u64::from(low)
}

unsafe fn write(register: u32, value: u64) {
    // SAFETY: as for `read`; the value is one that the register takes.
    unsafe {
        asm!("wrmsr", in("ecx") register, in("eax") value as u32, in("edx") (value >> 32) as u32,
            options(nostack, preserves_flags));
    }
}
