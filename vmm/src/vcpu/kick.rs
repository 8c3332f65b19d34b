//! The kick: taking a vCPU's thread out of guest mode, whatever the guest does.
//!
//! A signal makes KVM leave the guest, but a signal that arrives just *before* `KVM_RUN` would be
//! handled and forgotten, and the guest entered, and no further signal would end it. So the handler sets
//! `kvm_run.immediate_exit`, which makes that next `KVM_RUN` return at once. The protocol:
//!
//! 1. the window enforcer makes its reason visible (window's end passed, stop flag set), then signals;
//! 2. the vCPU's thread clears `immediate_exit`, *then* looks for reasons, then enters.
//!
//! A kick before the clearing is seen in step 2 by its reason; a kick after it leaves
//! `immediate_exit` set. None is lost. The handler finds the flag through a pointer that is local
//! to the thread and null whenever there is no vCPU, so a late signal does nothing.
//!
//! The signal is a classic one. Several that wait for a thread are one, and the kernel never refuses one. Real-time signals
//! are queued, and each counts against a limit of the user (`RLIMIT_SIGPENDING`; `__send_signal_locked` in
//! `kernel/signal.c`): kicks for a thread that is stuck in the kernel would in the end keep all others from being sent.

use std::cell::Cell;
use std::marker::PhantomData;
use std::mem;
use std::ptr;
use std::sync::atomic::{Ordering, compiler_fence};

use kvm_ioctls::VcpuFd;
use libc::{c_int, c_void, siginfo_t};
use vmm_sys_util::signal::{register_signal_handler, unblock_signal};

use super::exit_count::ExitCount;

/// Most pieces of an access that are waited for: twice as many as the longest has that KVM emulates, of 64 bytes.
const PIECES: usize = 16;

/// The kick. Without the handler it is ignored.
const SIGNAL: c_int = libc::SIGURG;

thread_local! {
    /// `immediate_exit` of the vCPU that this thread owns.
    static IMMEDIATE_EXIT: Cell<*mut u8> = const { Cell::new(ptr::null_mut()) };
}

extern "C" fn handler(_: c_int, _: *mut siginfo_t, _: *mut c_void) {
    IMMEDIATE_EXIT.with(|flag| {
        let flag = flag.get();
        if !flag.is_null() {
            // SAFETY: `Kickable` set the pointer to a byte of this thread's own vCPU mapping and
            // clears it before the mapping goes. The thread is stopped in this handler, so its
            // own accesses do not run at the same time; the kernel reads the byte as it is.
            unsafe { flag.write_volatile(1) }
        }
    });
}

/// Installs the handler; once, before any vCPU thread starts. A parent process may have blocked the signal.
///
/// # Errors
/// What `sigaction` says.
pub fn install() -> Result<(), vmm_sys_util::errno::Error> {
    register_signal_handler(SIGNAL, handler)?;
    // Fails only for a number that is no signal's.
    let _ = unblock_signal(SIGNAL);
    Ok(())
}

/// Signals a thread of this process. A thread that has ended does no harm: its id is not found, or
/// belongs to a thread whose pointer is null.
pub(super) fn send(thread: i32) {
    // SAFETY: tgkill only sends a signal; it touches no memory. The handler is installed.
    unsafe { libc::syscall(libc::SYS_tgkill, libc::getpid(), thread, SIGNAL) };
}

/// The id under which [`send`] reaches the calling thread.
pub(crate) fn this_thread() -> i32 {
    // Not `libc::gettid`: the standard library declares that weak, and a linker that has one reference
    // to it left takes none of the C library's (`docs/dependencies.md`).
    // SAFETY: gettid has no preconditions and no effect. Its result is a small number.
    unsafe { libc::syscall(libc::SYS_gettid) as i32 }
}

/// A vCPU that can be kicked, on the thread that made it so.
pub struct Kickable {
    vcpu: VcpuFd,
    exit_count: Option<ExitCount>,
    /// The pointer is this thread's, so the value must stay on it.
    _not_send: PhantomData<*mut u8>,
}

impl Kickable {
    /// Takes over a vCPU for the calling thread.
    #[must_use]
    pub fn new(mut vcpu: VcpuFd) -> Self {
        let flag = &raw mut vcpu.get_kvm_run().immediate_exit;
        IMMEDIATE_EXIT.set(flag);
        let exit_count = ExitCount::of(&vcpu);
        Self { vcpu, exit_count, _not_send: PhantomData }
    }

    /// Takes over another vCPU in the place of this one, which is returned.
    pub fn replace(&mut self, vcpu: VcpuFd, exit_count: Option<ExitCount>) -> VcpuFd {
        // A kick in between finds no flag. The flag would be cleared before the next entry anyway.
        IMMEDIATE_EXIT.set(ptr::null_mut());
        compiler_fence(Ordering::SeqCst);
        let old = mem::replace(&mut self.vcpu, vcpu);
        self.exit_count = exit_count;
        IMMEDIATE_EXIT.set(&raw mut self.vcpu.get_kvm_run().immediate_exit);
        old
    }

    /// Exits of the vCPU as KVM counts them; 0 if it does not tell.
    #[must_use]
    pub fn count_exits(&self) -> u64 {
        self.exit_count.as_ref().and_then(ExitCount::read).unwrap_or(0)
    }

    /// Interrupts that KVM has injected into the vCPU; `None` if it does not tell.
    #[must_use]
    pub fn count_injections(&self) -> Option<u64> {
        self.exit_count.as_ref().and_then(ExitCount::injections)
    }

    /// Forgets earlier kicks. The reasons for a kick must be looked for *after* this.
    pub fn clear(&mut self) {
        self.vcpu.set_kvm_immediate_exit(0);
        // The handler runs on this very thread, so it is only the compiler that could move the
        // store past the reads that follow.
        compiler_fence(Ordering::SeqCst);
    }

    /// The vCPU.
    pub fn vcpu(&mut self) -> &mut VcpuFd {
        &mut self.vcpu
    }

    /// Ends what the last exit has left to be done, while memory is still that of the guest that has left. Of a string
    /// instruction it ends the element that has begun: KVM would go on with up to 1024 others, one for each exit.
    pub fn settle(&mut self) {
        if let Ok(mut registers) = self.vcpu.get_regs() {
            registers.rcx = 1;
            let _ = self.vcpu.set_regs(&registers);
        }
        // What is left then is found before the next guest starts.
        let _ = self.prime();
    }

    /// Runs the vCPU without entering the guest: what KVM does on a thread's first `KVM_RUN`,
    /// such as starting a worker, must not fall into a window, and a SCHED_DEADLINE thread is
    /// refused it (`EAGAIN`).
    ///
    /// It also ends what the last exit has left to be done.
    ///
    /// # Errors
    /// Any answer of KVM other than that it came back at once, or if more is left than an access has pieces.
    pub fn prime(&mut self) -> Result<(), kvm_ioctls::Error> {
        prime(&mut self.vcpu)
    }
}

/// See [`Kickable::prime`]; for a vCPU that another thread will take over.
///
/// # Errors
/// See there.
pub fn prime(vcpu: &mut VcpuFd) -> Result<(), kvm_ioctls::Error> {
    vcpu.set_kvm_immediate_exit(1);
    until_nothing_is_left(|| vcpu.run().map(drop))
}

/// An access of more than 8 bytes, or across two pages, comes in pieces, an exit for each. KVM finishes the
/// instruction after the last piece, and writes the registers then: those of the next guest, if a piece is left.
fn until_nothing_is_left(
    mut run: impl FnMut() -> Result<(), kvm_ioctls::Error>,
) -> Result<(), kvm_ioctls::Error> {
    for _ in 0..PIECES {
        match run() {
            Ok(()) => {}
            Err(e) if e.errno() == libc::EINTR => return Ok(()),
            Err(e) => return Err(e),
        }
    }
    Err(kvm_ioctls::Error::new(libc::EBUSY))
}

impl Drop for Kickable {
    fn drop(&mut self) {
        IMMEDIATE_EXIT.set(ptr::null_mut());
        compiler_fence(Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What priming comes to if KVM exits so often before it comes back at once with `errno`, and how often it ran.
    fn primed(pieces: usize, errno: i32) -> (Result<(), i32>, usize) {
        let mut runs = 0;
        let result = until_nothing_is_left(|| {
            runs += 1;
            if runs <= pieces { Ok(()) } else { Err(kvm_ioctls::Error::new(errno)) }
        });
        (result.map_err(|e| e.errno()), runs)
    }

    #[test]
    fn all_pieces_of_an_access_are_over_before_a_guest_is_started_anew() {
        assert_eq!(primed(0, libc::EINTR), (Ok(()), 1));
        assert_eq!(primed(1, libc::EINTR), (Ok(()), 2));
        assert_eq!(primed(PIECES - 1, libc::EINTR), (Ok(()), PIECES));
    }

    /// One thread is deaf, and no kick may wait for another's room. In a process of its own, since the limit is the process's.
    #[test]
    fn kicks_that_a_thread_does_not_take_keep_none_from_others() {
        use std::os::unix::process::CommandExt;
        use std::process::Command;
        use std::time::Instant;
        const INSIDE: &str = "TAKT_TEST_KICKS";
        if std::env::var_os(INSIDE).is_none() {
            let name = "vcpu::kick::tests::kicks_that_a_thread_does_not_take_keep_none_from_others";
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.args(["--exact", name]).env(INSIDE, "yes");
            let none = libc::rlimit { rlim_cur: 4, rlim_max: 4 };
            // SAFETY: setrlimit may be called between fork and exec, and reads a live structure.
            unsafe {
                command.pre_exec(move || {
                    match libc::setrlimit(libc::RLIMIT_SIGPENDING, &raw const none) {
                        0 => Ok(()),
                        _ => Err(std::io::Error::last_os_error()),
                    }
                })
            };
            assert!(command.status().unwrap().success());
            return;
        }
        install().unwrap();
        let deaf = this_thread();
        vmm_sys_util::signal::block_signal(SIGNAL).unwrap();
        (0..100).for_each(|_| send(deaf));
        // Longer than any machine takes.
        let until = Instant::now() + std::time::Duration::from_secs(60);
        let (tell, told) = std::sync::mpsc::channel();
        let other = std::thread::spawn(move || {
            let _ = unblock_signal(SIGNAL);
            let mut flag = 0;
            IMMEDIATE_EXIT.set(&raw mut flag);
            tell.send(this_thread()).unwrap();
            // SAFETY: the flag lives as long as this thread, whose handler alone writes it.
            while unsafe { (&raw const flag).read_volatile() } == 0 {
                assert!(Instant::now() < until, "the kick has not come");
                std::thread::yield_now();
            }
            IMMEDIATE_EXIT.set(ptr::null_mut());
        });
        send(told.recv().unwrap());
        other.join().unwrap();
    }

    #[test]
    fn what_has_no_end_or_fails_is_an_error() {
        assert_eq!(primed(PIECES, libc::EINTR), (Err(libc::EBUSY), PIECES));
        assert_eq!(primed(1, libc::EFAULT), (Err(libc::EFAULT), 2));
    }
}
