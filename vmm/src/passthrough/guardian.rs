//! The guardian: a process that writes safe values when Takt is no more.
//!
//! A process that is killed (SIGKILL, the kernel's out-of-memory killer) or that dies of a fault of
//! its own (SIGSEGV, SIGBUS) does nothing any more. No other process knows its outputs, so they would
//! stay as the last scan left them. So where there are safe values, Takt forks
//! a second process at its start, which waits at a pipe. The end of the pipe that Takt
//! holds is closed by the kernel when the last thread of Takt has left its guest for good, so what
//! the guardian then writes stays. If the run ends in order, Takt tells the guardian, and it ends.
//!
//! It keeps one privilege, to take ports when it has to write, and is shut in otherwise as all threads
//! of Takt are.
//!
//! It is forked before there are guests, their memory and any other thread, and closes everything but
//! the pipe: it holds nothing of Takt's but the mappings of devices. It is in a session of its own,
//! so that what is sent to Takt's terminal or process group does not reach it, and is the last
//! process that the kernel would kill for want of memory.
//!
//! What takes both processes, or the kernel, still leaves the outputs as they were:
//! `docs/safe-values.md` says what remains.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::fd::{AsRawFd, FromRawFd, RawFd};

use super::safe_values::SafeValues;
use crate::sandbox::{self, Kind, Mode};

/// Told to the guardian when all has ended in order.
const IN_ORDER: u8 = 1;

/// The guardian of a run. Dropping it says that the run has ended in order.
pub struct Guardian {
    pipe: File,
    process: libc::pid_t,
}

impl Guardian {
    /// Forks a guardian of these values; `None` if there are none.
    ///
    /// # Errors
    /// If the host gives no pipe or no process.
    pub fn start(all: &[SafeValues], mode: Mode) -> io::Result<Option<Guardian>> {
        if all.iter().all(SafeValues::is_empty) {
            return Ok(None);
        }
        let mut ends = [-1; 2];
        // SAFETY: fills in two live descriptors.
        if unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) } != 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: both are new and have no other owner.
        let [read, write] = ends.map(|fd| unsafe { File::from_raw_fd(fd) });
        // SAFETY: the child uses nothing that another thread could have held at this moment, of
        // which there is none in a run; the C library's heap is in order after a fork anyway. It ends
        // without running anything of its parent's.
        match unsafe { libc::fork() } {
            -1 => Err(io::Error::last_os_error()),
            0 => {
                // A writing end that stays open here would keep the pipe open.
                drop(write);
                watch(read, all, mode);
                // SAFETY: ends only this process, which is a copy.
                unsafe { libc::_exit(0) }
            }
            process => Ok(Some(Guardian { pipe: write, process })),
        }
    }
}

impl AsRawFd for Guardian {
    /// Takt's end of the pipe. Nothing comes by it, but when the guardian is gone it has an error.
    fn as_raw_fd(&self) -> RawFd {
        self.pipe.as_raw_fd()
    }
}

impl Drop for Guardian {
    fn drop(&mut self) {
        // One that is gone needs no word.
        let _ = self.pipe.write_all(&[IN_ORDER]);
        // SAFETY: waits for a child of this process; a null pointer asks for no status.
        unsafe { libc::waitpid(self.process, std::ptr::null_mut(), 0) };
    }
}

/// The guardian's life.
fn watch(mut pipe: File, all: &[SafeValues], mode: Mode) {
    leave_everything_but(pipe.as_raw_fd());
    // With fewer privileges if that can be had, but with them if not.
    let _ = sandbox::enter(Kind::Guardian, mode, "guardian", &[]);
    let mut word = [0];
    loop {
        match pipe.read(&mut word) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Ok(1) if word == [IN_ORDER] => return,
            _ => break,
        }
    }
    all.iter().for_each(SafeValues::write_from_anywhere);
}

/// Each of these makes the guardian safer, and none is needed for its work.
fn leave_everything_but(pipe: RawFd) {
    let (below, above) = (pipe.saturating_sub(1), pipe.saturating_add(1));
    // Before the pipe is the only descriptor: it needs one for a moment.
    let _ = fs::write("/proc/self/oom_score_adj", "-1000");
    // SAFETY: no call touches memory but for reading the name, which ends with a NUL. The
    // descriptors are a copy of the parent's, and nothing in this process uses them any more.
    unsafe {
        libc::syscall(libc::SYS_close_range, 0, below, 0);
        libc::syscall(libc::SYS_close_range, above, u32::MAX, 0);
        libc::setsid();
        libc::prctl(libc::PR_SET_NAME, c"takt-guardian".as_ptr());
        libc::mlockall(libc::MCL_CURRENT);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::mapping::Mapping;
    use super::super::safe_values::{Target, Write as Value};
    use super::*;
    use crate::vcpu::port_access::Width;

    /// A file in the place of a device, and a guardian of its first register.
    fn guarded(name: &str) -> (File, Guardian) {
        let path = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
        let mut options = File::options();
        let file = options.read(true).write(true).create(true).truncate(true).open(&path).unwrap();
        fs::remove_file(&path).unwrap();
        file.set_len(4096).unwrap();
        let memory = Arc::new(Mapping::new(&file, 0, 4096).unwrap());
        let target = Target::Register(memory, 0);
        let values = SafeValues::new(vec![Value { target, width: Width::Four, value: 7 }]);
        let guardian = Guardian::start(&[SafeValues::default(), values], Mode::Enforce).unwrap();
        (file, guardian.unwrap())
    }

    fn register(mut file: &File) -> u32 {
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes).unwrap();
        u32::from_le_bytes(bytes)
    }

    #[test]
    fn a_run_that_ends_in_order_is_left_alone() {
        let (file, guardian) = guarded("in-order");
        drop(guardian);
        assert_eq!(register(&file), 0);
    }

    #[test]
    fn values_are_written_when_the_last_writer_is_gone() {
        let (file, guardian) = guarded("killed");
        // What the kernel does to a process that is killed.
        // SAFETY: the descriptor is the guardian's own, which is not dropped after that.
        unsafe { libc::close(guardian.pipe.as_raw_fd()) };
        // SAFETY: waits for a child of this process.
        unsafe { libc::waitpid(guardian.process, std::ptr::null_mut(), 0) };
        std::mem::forget(guardian);
        assert_eq!(register(&file), 7);
    }

    #[test]
    fn it_is_shut_in_while_it_waits() {
        let (_file, guardian) = guarded("shut-in");
        let path = format!("/proc/{}/status", guardian.process);
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
        // The filter is the last of it, so the rest holds when that does.
        let status = loop {
            let status = fs::read_to_string(&path).unwrap();
            if status.contains("Seccomp:\t2\n") {
                break status;
            }
            assert!(std::time::Instant::now() < deadline, "{status}");
            std::thread::yield_now();
        };
        // That for ports, and where the limit of locked memory holds, the one for that.
        const KEPT: u64 = 1 << 17 | 1 << 14;
        let capabilities = status.lines().find_map(|line| line.strip_prefix("CapPrm:\t")).unwrap();
        let capabilities = u64::from_str_radix(capabilities, 16).unwrap();
        assert_eq!(capabilities & !KEPT, 0, "{status}");
        assert!(status.contains("NoNewPrivs:\t1\n"), "{status}");
    }

    #[test]
    fn without_values_there_is_no_guardian() {
        assert!(Guardian::start(&[SafeValues::default()], Mode::Enforce).unwrap().is_none());
    }
}
