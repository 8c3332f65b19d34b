//! A guest that spoils whatever of its processor it can reach, and then fails; started again, it looks
//! whether anything of that is left.
//!
//! What it found at its first start lies where a warm start keeps it. It also tries what a guest need
//! not have: nested virtualisation, and performance counters.

#![no_std]
#![no_main]

use core::arch::asm;
use core::arch::naked_asm;
use core::arch::x86_64::{__cpuid_count, _rdtsc};
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use takt_abi::start::WARM;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

/// Cycles before it spoils anything, so that a restart is one of a guest that was well.
const GOOD_CYCLES: u32 = 20;
/// What a register reads as that there is not.
const NONE: u64 = 0xdead_dead_dead_dead;

const EFER: u32 = 0xc000_0080;
const SVME: u64 = 1 << 12;

/// How a model-specific register is spoilt.
#[derive(Clone, Copy)]
enum Spoil {
    /// Set to this.
    To(u64),
    /// These bits the other way round.
    Flip(u64),
    /// To the address of memory of the guest's own, and switched on.
    Page,
}
use Spoil::{Flip, Page, To};

const MSRS: [(u32, Spoil); 34] = [
    (0x3b, To(1 << 40)),  // time stamp counter adjustment
    (0x1b, Flip(0x1000)), // APIC base
    (0x48, Flip(1)),      // speculation control
    (0x174, To(0x1234)),  // entry by SYSENTER
    (0x175, To(0x1234_5000)),
    (0x176, To(0x1234_5000)),
    (0x1a0, Flip(1)),         // miscellaneous features
    (0x1d9, Flip(1)),         // debug control
    (0x200, To(0xd000_0006)), // memory types: variable
    (0x201, To(0xf000_0800)),
    (0x20e, To(0xe000_0000)),
    (0x250, To(0x0606_0606_0606_0606)), // fixed
    (0x259, To(0x0505_0505_0505_0505)),
    (0x26f, To(0x0404_0404_0404_0404)),
    (0x2ff, To(0xc06)),                   // default
    (0x277, Flip(0x0200_0000_0000_0000)), // page attributes
    (0x402, To(0x5_1234_5678)),           // machine check: address and more
    (0x403, To(0x5_1234_5678)),
    (0x40e, To(0x5_1234_5678)), // of a bank that there is not
    (0x4b56_4d01, Page),        // KVM's time
    (0x4b56_4d03, Page),        // KVM's stolen time
    (0xc000_0081, To(0x1234_5678_0000_0000)), // entry by SYSCALL
    (0xc000_0082, To(0x1234_5000)),
    (0xc000_0083, To(0x1234_5000)),
    (0xc000_0084, To(0x1234)),
    (0xc000_0100, To(0x1234_5000)), // segment bases
    (0xc000_0101, To(0x1234_5000)),
    (0xc000_0102, To(0x1234_5000)),
    (0xc000_0103, To(0x1234)),    // auxiliary value of RDTSCP
    (0xc001_0015, Flip(1 << 18)), // hardware configuration
    (0xc001_0114, Flip(1 << 4)),  // control of virtual machines
    (0xc001_0140, To(0x12)),      // work-arounds
    (0xc001_0141, To(0x12)),
    (EFER, Flip(1)),
];
/// Others: CR2, CR8, XCR0, DR0, DR3, DR7, x87 control, MXCSR, the upper half of YMM15, DR1, DR2, and DR6.
const OTHERS: usize = 12;
const STATES: usize = MSRS.len() + OTHERS;

#[unsafe(link_section = ".retain")]
static FIRST: [AtomicU64; STATES] = [const { AtomicU64::new(0) }; STATES];
static FAULTED: AtomicBool = AtomicBool::new(false);

#[repr(C, align(64))]
struct Shared([u8; 64]);
/// What KVM may write to.
static mut PAGES: [Shared; 2] = [const { Shared([0; 64]) }; 2];

/// Goes on behind the instruction, of two bytes, that was refused.
#[unsafe(naked)]
extern "C" fn refused() {
    naked_asm!(
        "mov byte ptr [rip + {faulted}], 1",
        "add qword ptr [rsp + 8], 2",
        "add rsp, 8",
        "iretq",
        faulted = sym FAULTED,
    )
}

/// Makes a general protection fault come to [`refused`].
fn catch_faults() {
    #[repr(C, packed)]
    struct Register {
        limit: u16,
        base: u64,
    }
    let mut register = Register { limit: 0, base: 0 };
    // SAFETY: the table is the guest's own and writable; a gate keeps its segment and stack, and its
    // handler leaves all registers as they were.
    unsafe {
        asm!("sidt [{}]", in(reg) &raw mut register, options(nostack));
        let gate = (register.base as *mut [u64; 2]).add(13);
        let handler = refused as extern "C" fn() as usize as u64;
        let [low, _] = gate.read();
        let low = low & 0x0000_ffff_ffff_0000 | handler & 0xffff | (handler >> 16 & 0xffff) << 48;
        gate.write([low, handler >> 32]);
    }
}

fn read_msr(index: u32) -> u64 {
    FAULTED.store(false, Relaxed);
    let (low, high): (u32, u32);
    // SAFETY: reading has no effect on memory, and a refusal is caught.
    unsafe { asm!("rdmsr", in("ecx") index, out("eax") low, out("edx") high) };
    if FAULTED.load(Relaxed) { NONE } else { u64::from(high) << 32 | u64::from(low) }
}

/// Whether the processor took it.
fn write_msr(index: u32, value: u64) -> bool {
    FAULTED.store(false, Relaxed);
    // SAFETY: what is written is nothing that the rest of this program uses, and a refusal is caught.
    unsafe {
        asm!("wrmsr", in("ecx") index, in("eax") value as u32, in("edx") (value >> 32) as u32)
    };
    !FAULTED.load(Relaxed)
}

fn has_avx() -> bool {
    __cpuid_count(1, 0).ecx >> 28 & 1 == 1
}

/// The states that are not model-specific registers.
fn others() -> [u64; OTHERS] {
    let (cr2, cr8, dr0, dr3, dr7): (u64, u64, u64, u64, u64);
    let (dr1, dr2, dr6): (u64, u64, u64);
    let (mut fcw, mut mxcsr) = (0_u16, 0_u32);
    // SAFETY: ring 0; nothing is written but the two variables.
    unsafe {
        asm!("mov {}, cr2", "mov {}, cr8", out(reg) cr2, out(reg) cr8, options(nostack));
        asm!("mov {}, dr0", "mov {}, dr3", "mov {}, dr7", out(reg) dr0, out(reg) dr3, out(reg) dr7);
        asm!("mov {}, dr1", "mov {}, dr2", "mov {}, dr6", out(reg) dr1, out(reg) dr2, out(reg) dr6);
        asm!("fnstcw [{}]", "stmxcsr [{}]", in(reg) &raw mut fcw, in(reg) &raw mut mxcsr);
    }
    let (mut xcr0, mut upper) = (NONE, NONE);
    if has_avx() {
        let mut ymm = [0_u64; 4];
        // SAFETY: the processor has these registers; the mask is put back.
        unsafe {
            let (low, high): (u32, u32);
            asm!("mov {0}, cr4", "or {0}, 1 << 18", "mov cr4, {0}", out(reg) _);
            asm!("xgetbv", in("ecx") 0, out("eax") low, out("edx") high);
            xcr0 = u64::from(high) << 32 | u64::from(low);
            asm!("xsetbv", in("ecx") 0, in("eax") 7, in("edx") 0);
            asm!("vmovdqu [{}], ymm15", in(reg) &raw mut ymm);
            asm!("xsetbv", in("ecx") 0, in("eax") low, in("edx") high);
        }
        upper = ymm[3];
    }
    [cr2, cr8, xcr0, dr0, dr3, dr7, fcw.into(), mxcsr.into(), upper, dr1, dr2, dr6]
}

fn spoil_others() {
    // SAFETY: ring 0. The breakpoints lie where nothing is executed, exceptions of floating-point
    // operations stay masked, and nothing else of this program uses the rest.
    unsafe {
        asm!("mov cr2, {0}", "mov cr8, {1}", in(reg) 0x1234_5678_u64, in(reg) 5_u64);
        asm!("mov dr0, {0}", "mov dr3, {0}", "mov dr7, {1}", in(reg) 0x7fff_0000_u64, in(reg) 0x482_u64);
        asm!("mov dr1, {0}", "mov dr2, {0}", "mov dr6, {1}", in(reg) 0x7fff_1000_u64, in(reg) 0xffff_0ff5_u64);
        asm!("fldcw [{}]", "ldmxcsr [{}]", in(reg) &0x17f_u16, in(reg) &0x9f80_u32);
        if has_avx() {
            asm!("xsetbv", in("ecx") 0, in("eax") 7, in("edx") 0);
            asm!("vcmptrueps ymm15, ymm15, ymm15");
        }
    }
}

fn states() -> [u64; STATES] {
    let mut states = [NONE; STATES];
    for (state, (index, _)) in states.iter_mut().zip(MSRS) {
        *state = read_msr(index);
    }
    states[MSRS.len()..].copy_from_slice(&others());
    states
}

/// A state's name: the number of a model-specific register, and for others their place, from 0x22 on.
fn name(number: usize) -> u32 {
    MSRS.get(number).map_or(number as u32, |(index, _)| *index)
}

fn spoil() {
    for (number, (index, how)) in MSRS.into_iter().enumerate() {
        let value = match how {
            To(value) => value,
            Flip(bits) => read_msr(index) ^ bits,
            Page => (&raw const PAGES) as u64 + 64 * (number as u64 & 1) + 1,
        };
        write_msr(index, value);
    }
    spoil_others();
    // SAFETY: `rdtsc` has no preconditions in ring 0.
    write_msr(0x10, unsafe { _rdtsc() } + (1 << 42));
}

/// What the first performance counter says.
fn counted() -> u32 {
    let count: u32;
    // SAFETY: reading a counter has no effect, and a refusal is caught.
    unsafe { asm!("rdpmc", in("ecx") 0, inout("eax") 0 => count, out("edx") _) };
    count
}

/// What a guest need not have.
fn look_for_more() {
    let nested = __cpuid_count(1, 0).ecx >> 5 & 1 | __cpuid_count(0x8000_0001, 0).ecx >> 2 & 1;
    let counters = __cpuid_count(0xa, 0).eax
        | __cpuid_count(0x8000_0001, 0).ecx >> 23 & 3
        | __cpuid_count(0x8000_0022, 0).eax;
    let efer = read_msr(EFER);
    let entered = write_msr(EFER, efer | SVME) && read_msr(EFER) & SVME != 0;
    FAULTED.store(false, Relaxed);
    // AMD's first counter, of cycles in all modes.
    write_msr(0xc001_0000, 0x53_0076);
    print(format_args!(
        "nested {nested}, counters {counters}, SVM {}, cycles {}",
        if entered { "on" } else { "refused" },
        if counted() == counted() { "not counted" } else { "counted" },
    ));
}

struct Spoiler {
    cycles: u32,
}

impl Program for Spoiler {
    fn scan(&mut self, _: &Cycle) {
        self.cycles += 1;
        if self.cycles != GOOD_CYCLES || pages::information().start_mode == WARM {
            return;
        }
        spoil();
        let mut spoilt = STATES;
        for (number, (now, first)) in states().into_iter().zip(&FIRST).enumerate() {
            if now == first.load(Relaxed) {
                print(format_args!("state {:#x} is as before: {now:#x}", name(number)));
                spoilt -= 1;
            }
        }
        print(format_args!("spoilt {spoilt} of {STATES}"));
        // SAFETY: the division raises an exception, from which the handler does not return. Assembly,
        // because a division by zero in Rust is a panic.
        unsafe {
            asm!("div {:e}", in(reg) 0_u32, inout("eax") 1_u32 => _, inout("edx") 0_u32 => _)
        };
    }
}

fn main() -> ! {
    catch_faults();
    let now = states();
    if pages::information().start_mode == WARM {
        let mut left = 0;
        for (number, (now, first)) in now.into_iter().zip(&FIRST).enumerate() {
            let first = first.load(Relaxed);
            if now != first {
                print(format_args!("state {:#x} was {first:#x} and is {now:#x}", name(number)));
                left += 1;
            }
        }
        print(format_args!("left of {STATES} states: {left}"));
    } else {
        FIRST.iter().zip(now).for_each(|(first, now)| first.store(now, Relaxed));
        look_for_more();
    }
    cycle::run(Spoiler { cycles: 0 })
}

entry!(main);
