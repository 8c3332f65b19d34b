//! Starting processes by the very calls that are to be measured, which the standard library hides.

use std::ffi::{CStr, CString};
use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::ptr;

/// A program and its arguments, ready for `execve`.
pub struct Program {
    path: CString,
    // Into literals, and ended by a null pointer.
    arguments: Vec<*const libc::c_char>,
}

impl Program {
    /// A program with these arguments, the first being its name.
    pub fn new(path: CString, arguments: &[&'static CStr]) -> Self {
        let arguments = arguments.iter().map(|a| a.as_ptr()).chain([ptr::null()]).collect();
        Self { path, arguments }
    }

    /// A program that only ends: no C library, and no CPUID.
    pub fn without_library() -> io::Result<Self> {
        const PATH: &str = "/tmp/takt-pay-bare";
        fs::write(PATH, bare())?;
        fs::set_permissions(PATH, Permissions::from_mode(0o755))?;
        Ok(Self::new(CString::new(PATH).map_err(io::Error::other)?, &[c"bare"]))
    }

    /// Becomes this program. Returns only if the kernel refuses.
    fn become_it(&self) {
        let none = [ptr::null()];
        // SAFETY: a path and two arrays of pointers to C strings, both ended by null.
        unsafe { libc::execve(self.path.as_ptr(), self.arguments.as_ptr(), none.as_ptr()) };
    }
}

/// An ELF executable of one segment (System V ABI, chapters 4 and 5): `mov eax, 60; xor edi, edi;
/// syscall`, which is exit(0).
fn bare() -> Vec<u8> {
    const BASE: u64 = 0x40_0000;
    const HEADERS: u64 = 64 + 56;
    const CODE: [u8; 9] = [0xb8, 60, 0, 0, 0, 0x31, 0xff, 0x0f, 0x05];
    let mut file = vec![0x7f, b'E', b'L', b'F', 2, 1, 1];
    file.resize(16, 0);
    let mut put = |bytes: &[u8]| file.extend_from_slice(bytes);
    // Executable, for x86-64, version 1.
    put(&[2, 0, 62, 0, 1, 0, 0, 0]);
    put(&(BASE + HEADERS).to_le_bytes());
    // Program headers right behind this header, no sections, no flags.
    put(&64u64.to_le_bytes());
    put(&0u64.to_le_bytes());
    put(&0u32.to_le_bytes());
    for half in [64u16, 56, 1, 0, 0, 0] {
        put(&half.to_le_bytes());
    }
    // A segment to load, readable and executable: the whole file.
    put(&[1, 0, 0, 0, 5, 0, 0, 0]);
    let length = HEADERS + CODE.len() as u64;
    for word in [0, BASE, BASE, length, length, 0x1000] {
        put(&word.to_le_bytes());
    }
    put(&CODE);
    file
}

/// The system call that does least.
pub fn getpid() {
    // SAFETY: no arguments, no effect.
    unsafe { libc::syscall(libc::SYS_getpid) };
}

/// A child by `fork`, which ends at once or becomes a program, and is waited for.
pub fn forked(program: Option<&Program>) -> io::Result<()> {
    // SAFETY: this process has one thread, and the child makes two system calls at most.
    match unsafe { libc::fork() } {
        0 => end(program),
        child => wait(child),
    }
}

/// As [`forked`], by the call behind `vfork`, which lends the child this process's memory. The
/// function itself returns twice on one stack, which Rust cannot have.
pub fn vforked(program: Option<&Program>) -> io::Result<()> {
    extern "C" fn child(program: *mut libc::c_void) -> libc::c_int {
        // SAFETY: `vforked` waits in `clone`, with the reference alive, until this has ended.
        end(unsafe { program.cast::<Option<&Program>>().as_ref() }.copied().flatten())
    }
    let mut stack = [0u128; 1024];
    let flags = libc::CLONE_VM | libc::CLONE_VFORK | libc::SIGCHLD;
    // SAFETY: the stack is the child's alone, grows from its end, and lives as long as the child
    // uses it, because the parent stands still until then.
    let pid = unsafe {
        let top = stack.as_mut_ptr_range().end;
        libc::clone(child, top.cast(), flags, (&raw const program).cast_mut().cast())
    };
    wait(pid)
}

/// The child's side.
fn end(program: Option<&Program>) -> ! {
    if let Some(program) = program {
        program.become_it();
    }
    // SAFETY: ends the process without running anything of the parent's.
    unsafe { libc::_exit(i32::from(program.is_some())) }
}

fn wait(child: libc::pid_t) -> io::Result<()> {
    let mut status = 0;
    // SAFETY: the kernel writes to `status`, which lives through the call.
    if child < 0 || unsafe { libc::waitpid(child, &raw mut status, 0) } < 0 {
        return Err(io::Error::last_os_error());
    }
    if libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 0 {
        return Ok(());
    }
    Err(io::Error::other(format!("the child ended with {status:#x}")))
}

/// How often a program executes CPUID from its start to its end, found by single steps.
pub fn cpuids_of_a_start(program: &Program) -> io::Result<u64> {
    const CPUID: i64 = 0xa20f;
    // SAFETY: one thread, and the child makes two system calls.
    let child = unsafe { libc::fork() };
    if child == 0 {
        // SAFETY: asks to be traced; takes no pointers.
        unsafe { libc::ptrace(libc::PTRACE_TRACEME, 0, 0, 0) };
        end(Some(program));
    }
    let mut count = 0;
    let mut status = 0;
    loop {
        // SAFETY: the kernel writes to `status`, which lives through the call.
        if child < 0 || unsafe { libc::waitpid(child, &raw mut status, 0) } < 0 {
            return Err(io::Error::last_os_error());
        }
        if !libc::WIFSTOPPED(status) {
            return Ok(count);
        }
        // SAFETY: the child is stopped; reading a register and a word, and going on by one
        // instruction, change no memory of this process. A word that cannot be read is -1.
        unsafe {
            let at = std::mem::offset_of!(libc::user_regs_struct, rip);
            let rip = libc::ptrace(libc::PTRACE_PEEKUSER, child, at, 0);
            let word = libc::ptrace(libc::PTRACE_PEEKTEXT, child, rip, 0);
            count += u64::from(word & 0xffff == CPUID);
            libc::ptrace(libc::PTRACE_SINGLESTEP, child, 0, 0);
        }
    }
}
