//! Runs compiled programs in the test's own process, at the addresses where they lie in a PLC.
//!
//! A trap is a SIGILL whose handler leaves the program by restoring the stack of the call, and says where it was.

use std::arch::global_asm;
use std::ptr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use takt_program::{TaskId, TaskInformation, address};
use takt_st::hir::Trap;
use takt_st::native::Native;

const CODE_BYTES: usize = 32 << 20;
const STATE_BYTES: usize = 1 << 20;
const PROCESS_IMAGE_BYTES: usize = 1 << 16;

global_asm!(
    ".global takt_st_test_enter, takt_st_test_leave",
    "takt_st_test_enter:",
    "push rbx; push rbp; push r12; push r13; push r14; push r15; sub rsp, 8",
    "mov [rip + takt_st_test_stack], rsp",
    // On the stack of the first task.
    "mov rsp, rdx",
    "mov rax, rdi; mov rdi, rsi; call rax",
    "xor eax, eax; jmp 1f",
    "takt_st_test_leave:",
    "mov eax, 1",
    "1: mov rsp, [rip + takt_st_test_stack]",
    "add rsp, 8; pop r15; pop r14; pop r13; pop r12; pop rbp; pop rbx; ret",
    ".bss",
    ".balign 8",
    "takt_st_test_stack: .skip 8",
    ".text",
);

unsafe extern "C" {
    fn takt_st_test_enter(function: u64, information: u64, stack: u64) -> u32;
    fn takt_st_test_leave();
}

/// Calls a function of the program as the first task; 1 if it trapped.
///
/// # Safety
/// The function must be in code that is loaded, and write to the areas and its stack only.
unsafe fn enter(function: u64) -> u32 {
    let task = TaskId(0);
    // SAFETY: as the caller says.
    unsafe {
        takt_st_test_enter(
            function,
            address::task_information(Some(task)),
            address::stack_end(task),
        )
    }
}

/// Where the last trap was.
static TRAPPED_AT: AtomicU64 = AtomicU64::new(0);

/// The memory of one program at a time.
pub struct Machine {
    _alone: MutexGuard<'static, ()>,
    entries: Vec<u64>,
    traps: Vec<takt_st::native::TrapSite>,
    init: u64,
}

fn map(at: u64, bytes: usize) {
    let rights = libc::PROT_READ | libc::PROT_WRITE | libc::PROT_EXEC;
    let flags =
        libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED_NOREPLACE | libc::MAP_NORESERVE;
    // SAFETY: a new mapping where nothing is, by MAP_FIXED_NOREPLACE.
    let mapped = unsafe { libc::mmap(at as *mut _, bytes, rights, flags, -1, 0) };
    assert_eq!(mapped as u64, at, "nothing else lies at the addresses of a program");
}

extern "C" fn on_trap(_: libc::c_int, _: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: the kernel gives the handler a context that is its own.
    let registers = unsafe { &mut (*context.cast::<libc::ucontext_t>()).uc_mcontext.gregs };
    let at = registers[libc::REG_RIP as usize] as u64;
    if !(address::CODE..address::CODE + CODE_BYTES as u64).contains(&at) {
        // SAFETY: only ends the process.
        unsafe { libc::abort() }
    }
    TRAPPED_AT.store(at, Ordering::Relaxed);
    registers[libc::REG_RIP as usize] = takt_st_test_leave as *const () as i64;
}

fn set_up() -> &'static Mutex<()> {
    static ALONE: OnceLock<Mutex<()>> = OnceLock::new();
    ALONE.get_or_init(|| {
        map(address::CODE, CODE_BYTES);
        map(address::STATE, STATE_BYTES);
        map(address::TASK_INFORMATION, 4096);
        map(address::STACKS, address::STACK_SLOT as usize);
        for area in [address::INPUT, address::OUTPUT, address::MARKER] {
            map(area, PROCESS_IMAGE_BYTES);
        }
        // SAFETY: the structure is plain data; the handler is async-signal-safe.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = on_trap as *const () as usize;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_NODEFER;
            assert_eq!(libc::sigaction(libc::SIGILL, &action, ptr::null_mut()), 0);
        }
        Mutex::new(())
    })
}

impl Machine {
    /// Loads a program with its initial state; inputs, outputs and markers are zero.
    pub fn load(native: &Native) -> Machine {
        let alone = set_up().lock().unwrap_or_else(PoisonError::into_inner);
        let mut machine = Machine {
            _alone: alone,
            entries: native
                .routines
                .iter()
                .map(|offset| address::CODE + u64::from(*offset))
                .collect(),
            traps: native.traps.clone(),
            init: address::CODE + u64::from(native.init),
        };
        machine.write(address::CODE, &native.code);
        machine.write(address::constants(native.code.len() as u32), &native.constants);
        machine.write(address::STATE, &native.state);
        for area in [address::INPUT, address::OUTPUT, address::MARKER] {
            machine.write(area, &[0; 4096]);
        }
        machine
    }

    pub fn write(&mut self, at: u64, bytes: &[u8]) {
        // SAFETY: all callers write to areas that are mapped.
        unsafe { ptr::copy_nonoverlapping(bytes.as_ptr(), at as *mut u8, bytes.len()) }
    }

    pub fn read(&self, at: u64, bytes: usize) -> Vec<u8> {
        // SAFETY: all callers read areas that are mapped; nothing runs at the same time.
        unsafe { std::slice::from_raw_parts(at as *const u8, bytes).to_vec() }
    }

    /// Runs `init`, as the kernel does before the first job.
    pub fn start(&mut self) {
        // SAFETY: as in `run`.
        let trapped = unsafe { enter(self.init) };
        assert_eq!(trapped, 0, "no initial value traps");
    }

    /// Runs the routine with this number once.
    pub fn run(
        &mut self,
        routine: usize,
        now_ns: u64,
        elapsed_ns: u64,
        cycle: u64,
    ) -> Result<(), Trap> {
        let information = TaskInformation {
            now: now_ns,
            period: elapsed_ns,
            cycle,
            ..TaskInformation::default()
        };
        let page = address::TASK_INFORMATION as *mut TaskInformation;
        // SAFETY: the page is mapped and aligned.
        unsafe { page.write(information) }
        // SAFETY: the code is the compiler's, which is what is tested: it writes to the areas and its stack only.
        let trapped = unsafe { enter(self.entries[routine]) };
        if trapped == 0 {
            return Ok(());
        }
        let offset = (TRAPPED_AT.load(Ordering::Relaxed) - address::CODE) as u32;
        match self.traps.iter().find(|site| site.offset == offset) {
            Some(site) => Err(site.trap),
            None => panic!("an illegal instruction at {offset:#x}, which is no trap"),
        }
    }
}
