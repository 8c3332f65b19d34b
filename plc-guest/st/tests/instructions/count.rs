//! Counts instructions by a trap for each: the processor stops behind every one of a job, and a handler adds one.

use std::arch::asm;
use std::sync::Once;
use std::sync::atomic::{AtomicU64, Ordering};

use takt_program::address;
use takt_st::hir::Trap;
use takt_st::native::Native;

use crate::machine::Machine;

/// Bit 8 of the flags: a trap behind each instruction.
const TRAP_FLAG: i64 = 1 << 8;

/// Instructions of a program, and those of them that are not the runtime's.
static ALL: AtomicU64 = AtomicU64::new(0);
static OWN: AtomicU64 = AtomicU64::new(0);
/// Where the runtime's functions end.
static OWN_FROM: AtomicU64 = AtomicU64::new(0);

/// What one job took.
pub struct Counted {
    /// Instructions with those of the runtime.
    pub all: u64,
    /// Instructions of the program itself.
    pub own: u64,
    /// How the job ended.
    pub ended: Result<(), Trap>,
}

/// A breakpoint begins and ends the stepping; what lies between, if it is the program's, is counted.
extern "C" fn on_step(
    _: libc::c_int,
    information: *mut libc::siginfo_t,
    context: *mut libc::c_void,
) {
    // SAFETY: the kernel gives the handler both, and they are its own.
    let (code, registers) = unsafe {
        let context = &mut *context.cast::<libc::ucontext_t>();
        ((*information).si_code, &mut context.uc_mcontext.gregs)
    };
    if code != libc::TRAP_TRACE {
        registers[libc::REG_EFL as usize] ^= TRAP_FLAG;
        return;
    }
    let at = registers[libc::REG_RIP as usize] as u64;
    if (address::CODE..address::STATE).contains(&at) {
        ALL.fetch_add(1, Ordering::Relaxed);
        OWN.fetch_add(u64::from(at >= OWN_FROM.load(Ordering::Relaxed)), Ordering::Relaxed);
    }
}

/// Runs a job of the routine and counts. The machine is held alone, so that one thread counts at a time.
pub fn job(machine: &mut Machine, native: &Native, routine: usize, cycle: u64) -> Counted {
    static HANDLER: Once = Once::new();
    HANDLER.call_once(|| {
        // SAFETY: the structure is plain data; the handler is async-signal-safe.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = on_step as *const () as usize;
            action.sa_flags = libc::SA_SIGINFO;
            assert_eq!(libc::sigaction(libc::SIGTRAP, &action, std::ptr::null_mut()), 0);
        }
    });
    // The runtime lies before the first routine.
    let first = native.routines.iter().min().copied().unwrap_or(0);
    OWN_FROM.store(address::CODE + u64::from(first), Ordering::Relaxed);
    ALL.store(0, Ordering::Relaxed);
    OWN.store(0, Ordering::Relaxed);
    // SAFETY: the handler is there, and goes on behind the breakpoint.
    unsafe { asm!("int3") };
    let ended = machine.run(routine, cycle * 1_000_000 + 17, cycle * 1_000_000, cycle);
    // SAFETY: as above.
    unsafe { asm!("int3") };
    Counted { all: ALL.load(Ordering::Relaxed), own: OWN.load(Ordering::Relaxed), ended }
}
