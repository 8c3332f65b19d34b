//! The process that a program runs in.

use std::ffi::{c_int, c_void};
use std::mem::MaybeUninit;
use std::time::{Duration, Instant};

use takt_program::address;

use super::HostError;
use super::memory::Memory;

/// The registers of the program.
pub type Registers = libc::user_regs_struct;

/// Why the program is not running.
pub enum Stop {
    /// It executed `syscall`.
    Call(Registers),
    /// It asked for something by another instruction: `int 0x80` or `sysenter`.
    ForeignCall(Registers),
    /// A signal of a fault.
    Signal { number: c_int, code: c_int, address: u64, registers: Registers },
    /// It was still running when its time was over.
    TimedOut(Registers),
    /// The process is gone.
    Gone,
}

/// The process. It is killed when this is dropped.
pub struct Child {
    pid: libc::pid_t,
}

/// Signals that the program itself causes.
const FAULTS: [c_int; 5] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, libc::SIGTRAP];
/// Marks stops by system calls (`PTRACE_O_TRACESYSGOOD`).
const CALL: c_int = 0x80;
/// First byte of all that does not belong to a program, above it.
const ABOVE: u64 = 0x7000_0000;
/// End of what a process can map (x86-64, four levels of page tables).
const TOP: u64 = 0x7fff_ffff_f000;
/// Request of `ptrace` that libc does not have: `PTRACE_GET_RSEQ_CONFIGURATION` (linux/ptrace.h).
const GET_RSEQ: u32 = 0x420f;
/// `RSEQ_FLAG_UNREGISTER` (linux/rseq.h).
const RSEQ_UNREGISTER: u64 = 1;

/// `struct ptrace_rseq_configuration` (linux/ptrace.h).
#[derive(Default)]
#[repr(C)]
struct Rseq {
    pointer: u64,
    bytes: u32,
    signature: u32,
    flags: u32,
    pad: u32,
}

impl Child {
    /// A process with only `memory` mapped, stopped before the program's first instruction.
    pub fn new(memory: &Memory) -> Result<Self, HostError> {
        let mut set = MaybeUninit::uninit();
        // SAFETY: `set` is initialised by the first call. SIGCHLD is blocked so that `wait` can take it.
        unsafe {
            libc::sigemptyset(set.as_mut_ptr());
            libc::sigaddset(set.as_mut_ptr(), libc::SIGCHLD);
            libc::sigprocmask(libc::SIG_BLOCK, set.as_ptr(), std::ptr::null_mut());
        }
        // SAFETY: this process has one thread, so the child has all of it.
        let pid = unsafe { libc::fork() };
        match pid {
            -1 => return Err(HostError::last("fork")),
            0 => become_program(memory),
            _ => {}
        }
        let child = Self { pid };
        child.expect_stop(libc::SIGSTOP)?;
        let options = libc::PTRACE_O_EXITKILL | libc::PTRACE_O_TRACESYSGOOD;
        child.ptrace(libc::PTRACE_SETOPTIONS, 0, options as u64, "PTRACE_SETOPTIONS")?;
        // The C library has told the kernel of an area that the kernel writes. It is about to be unmapped.
        let mut rseq = Rseq::default();
        let (bytes, at) = (size_of::<Rseq>() as u64, (&raw mut rseq) as u64);
        // Linux before 5.13 has no such request, and then leaves the pointer 0.
        let _ = child.ptrace(GET_RSEQ, bytes, at, "PTRACE_GET_RSEQ_CONFIGURATION");
        let told = [rseq.pointer, rseq.bytes.into(), rseq.signature.into()];
        for (index, word) in told.into_iter().enumerate() {
            memory.put(address::TASK_INFORMATION + 8 * index as u64, &word.to_le_bytes());
        }
        child.ptrace(libc::PTRACE_CONT, 0, 0, "PTRACE_CONT")?;
        child.expect_stop(libc::SIGTRAP)?;
        memory.put(address::TASK_INFORMATION, &[0; 8 * 3]);
        Ok(child)
    }

    fn expect_stop(&self, signal: c_int) -> Result<(), HostError> {
        let mut status = 0;
        // SAFETY: waits for an own child.
        if unsafe { libc::waitpid(self.pid, &raw mut status, 0) } != self.pid {
            return Err(HostError::last("waitpid"));
        }
        let stopped = libc::WIFSTOPPED(status) && libc::WSTOPSIG(status) == signal;
        if stopped { Ok(()) } else { Err(HostError::SetUp(status)) }
    }

    fn ptrace(
        &self,
        request: u32,
        address: u64,
        data: u64,
        doing: &'static str,
    ) -> Result<(), HostError> {
        // SAFETY: the child is stopped; where `address` or `data` is a pointer, the callers give one to a structure of
        // the size that the request fills.
        let result =
            unsafe { libc::ptrace(request, self.pid, address as *mut c_void, data as *mut c_void) };
        if result == -1 { Err(HostError::last(doing)) } else { Ok(()) }
    }

    /// The registers of the stopped program.
    pub fn registers(&self) -> Result<Registers, HostError> {
        let mut registers = MaybeUninit::<Registers>::zeroed();
        self.ptrace(libc::PTRACE_GETREGS, 0, registers.as_mut_ptr() as u64, "PTRACE_GETREGS")?;
        // SAFETY: all zeros are registers too, and the kernel has filled them in.
        Ok(unsafe { registers.assume_init() })
    }

    /// The state of FPU and SSE of the stopped program.
    pub fn vectors(&self) -> Result<libc::user_fpregs_struct, HostError> {
        let mut vectors = MaybeUninit::<libc::user_fpregs_struct>::zeroed();
        self.ptrace(libc::PTRACE_GETFPREGS, 0, vectors.as_mut_ptr() as u64, "PTRACE_GETFPREGS")?;
        // SAFETY: as for the registers.
        Ok(unsafe { vectors.assume_init() })
    }

    /// Sets the state of FPU and SSE.
    pub fn set_vectors(&self, vectors: &libc::user_fpregs_struct) -> Result<(), HostError> {
        self.ptrace(
            libc::PTRACE_SETFPREGS,
            0,
            std::ptr::from_ref(vectors) as u64,
            "PTRACE_SETFPREGS",
        )
    }

    /// Goes on with these registers until something happens, and at most until `deadline`.
    pub fn run(&self, registers: &Registers, deadline: Instant) -> Result<Stop, HostError> {
        let at = std::ptr::from_ref(registers) as u64;
        self.ptrace(libc::PTRACE_SETREGS, 0, at, "PTRACE_SETREGS")?;
        let status = loop {
            self.ptrace(libc::PTRACE_SYSEMU, 0, 0, "PTRACE_SYSEMU")?;
            let Some(status) = self.wait(deadline)? else {
                // SAFETY: stops an own child.
                unsafe { libc::kill(self.pid, libc::SIGSTOP) };
                return match self.wait(Instant::now() + Duration::from_secs(10))? {
                    Some(status) if libc::WIFSTOPPED(status) => {
                        Ok(Stop::TimedOut(self.registers()?))
                    }
                    _ => Ok(Stop::Gone),
                };
            };
            if !libc::WIFSTOPPED(status) {
                return Ok(Stop::Gone);
            }
            // Others come from outside, and do not concern the program.
            if FAULTS.contains(&(libc::WSTOPSIG(status) & !CALL)) {
                break status;
            }
        };
        let registers = self.registers()?;
        match libc::WSTOPSIG(status) {
            signal if signal == libc::SIGTRAP | CALL => Ok(Stop::Call(registers)),
            number => {
                let mut info = MaybeUninit::<libc::siginfo_t>::zeroed();
                let at = info.as_mut_ptr() as u64;
                self.ptrace(libc::PTRACE_GETSIGINFO, 0, at, "PTRACE_GETSIGINFO")?;
                // SAFETY: all zeros are a siginfo_t too, and the kernel has filled it in.
                let info = unsafe { info.assume_init() };
                // SAFETY: the field is read as a number only; for signals that are no faults it means nothing.
                let address = unsafe { info.si_addr() } as u64;
                Ok(Stop::Signal { number, code: info.si_code, address, registers })
            }
        }
    }

    /// The status of the process when it stops or ends, or nothing when the time is over.
    fn wait(&self, deadline: Instant) -> Result<Option<c_int>, HostError> {
        loop {
            let mut status = 0;
            // SAFETY: asks for an own child.
            match unsafe { libc::waitpid(self.pid, &raw mut status, libc::WNOHANG) } {
                0 => {}
                -1 => return Err(HostError::last("waitpid")),
                _ => return Ok(Some(status)),
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            let left = libc::timespec {
                tv_sec: left.as_secs().cast_signed(),
                tv_nsec: left.subsec_nanos().into(),
            };
            let mut set = MaybeUninit::uninit();
            // SAFETY: `set` is initialised by the first call; SIGCHLD has been blocked.
            unsafe {
                libc::sigemptyset(set.as_mut_ptr());
                libc::sigaddset(set.as_mut_ptr(), libc::SIGCHLD);
                libc::sigtimedwait(set.as_ptr(), std::ptr::null_mut(), &raw const left);
            }
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // SAFETY: ends and collects an own child, which has not been collected while `pid` is held, or is gone, and
        // then the calls fail.
        unsafe {
            libc::kill(self.pid, libc::SIGKILL);
            libc::waitpid(self.pid, std::ptr::null_mut(), 0);
        }
    }
}

/// In the child: maps the program, unmaps everything else, and stops.
fn become_program(memory: &Memory) -> ! {
    // SAFETY: only system calls on the child's own memory and state. The mappings lie where nothing is, or the call
    // fails. After the jump nothing of this tool is executed or read.
    unsafe {
        if libc::ptrace(libc::PTRACE_TRACEME, 0, 0, 0) != 0 {
            libc::_exit(1);
        }
        // A terminal signals all of a group: Ctrl-C, Ctrl-Z and a new size are for the tool alone.
        libc::setpgid(0, 0);
        let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        libc::setrlimit(libc::RLIMIT_CORE, &raw const none);
        for region in memory.regions() {
            let flags = libc::MAP_SHARED | libc::MAP_FIXED_NOREPLACE;
            let mapped = libc::mmap(
                region.address as *mut c_void,
                region.bytes as usize,
                region.rights.protection(),
                flags,
                memory.descriptor(),
                region.offset.cast_signed(),
            );
            if mapped as u64 != region.address {
                libc::_exit(2);
            }
        }
        libc::raise(libc::SIGSTOP);
        let told = address::TASK_INFORMATION as *const u64;
        let [pointer, bytes, signature] = [told.read(), told.add(1).read(), told.add(2).read()];
        if pointer != 0 {
            libc::syscall(libc::SYS_rseq, pointer, bytes, RSEQ_UNREGISTER, signature);
        }
        std::arch::asm!(
            "jmp rax",
            in("rax") Memory::clear_stub(),
            in("rdi") 0_u64,
            in("rsi") address::CALL_PAGE,
            in("r12") ABOVE,
            in("r13") TOP - ABOVE,
            options(noreturn),
        )
    }
}
