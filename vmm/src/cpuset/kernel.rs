//! What is asked of the kernel to set a CPU apart, beside the tree of its cgroups.

use std::fs;
use std::io;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use takt_scheduler::enforce::{become_deadline, pin_to};
use takt_scheduler::reservation::Reservation;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::Nanos;

use crate::kernel_tree::{LockedTree, Tree, write_line};

/// A share of one per cent: small enough to be free on any CPU that is worth running on. What the
/// thread has used of it stays reserved for up to a period after its end.
const TRIAL: Reservation =
    Reservation { runtime: Nanos::from_micros(100), period: Nanos::from_millis(10) };
/// All memory is locked, so a stack costs what it may grow to.
const STACK: usize = 64 * 1024;
const PAUSE: Duration = Duration::from_millis(1);

/// A cgroup v2 hierarchy and its scheduler. A cgroup that is removed must have no threads.
pub trait Kernel: Tree {
    /// The cgroup that this process is in.
    fn home(&self) -> io::Result<String>;
    /// The name of a thread.
    fn name_of(&self, thread: &str) -> String;
    /// Why a thread cannot be a deadline thread on this CPU, if it cannot, when it has entered
    /// `cgroup` first.
    fn refusal(&self, cpu: Cpu, cgroup: Option<&str>) -> io::Result<Option<io::Error>>;
    /// Waits a little for something that is about to happen.
    fn pause(&self);
}

/// A cgroup that threads of this process may enter.
#[derive(Clone, Debug)]
pub struct Entry {
    threads: PathBuf,
}

impl Entry {
    /// Threads enter by this file.
    #[must_use]
    pub(super) fn by(threads: PathBuf) -> Self {
        Self { threads }
    }

    /// Moves the calling thread there. Must come before it is pinned, which the move overwrites.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn enter(&self) -> io::Result<()> {
        // 0 is the writer itself (kernel/cgroup/cgroup.c, `cgroup_procs_write_start`).
        write_line(&self.threads, "0")
    }
}

/// Why a thread that is pinned to `cpu` cannot be a deadline thread, if it is a matter of its
/// scheduling domain: `EPERM`, or not even the pinning is possible, as when a killed Takt has left
/// the CPU set apart. Whatever else is wrong, the thread that it matters to will tell better.
///
/// # Errors
/// If the host gives no thread to try with.
pub fn refusal(cpu: Cpu, entry: Option<Entry>) -> io::Result<Option<io::Error>> {
    let attempt = move || -> io::Result<()> {
        if let Some(entry) = entry {
            entry.enter()?;
        }
        pin_to(cpu)?;
        match become_deadline(TRIAL) {
            Err(error) if error.raw_os_error() == Some(libc::EPERM) => Err(error),
            _ => Ok(()),
        }
    };
    let thread = thread::Builder::new().name("trial".into()).stack_size(STACK).spawn(attempt)?;
    match thread.join() {
        Ok(result) => Ok(result.err()),
        Err(_) => Err(io::Error::other("the thread died")),
    }
}

impl Kernel for LockedTree {
    fn home(&self) -> io::Result<String> {
        let all = fs::read_to_string("/proc/self/cgroup")?;
        let own = all.lines().find_map(|line| line.strip_prefix("0::/"));
        own.map(str::to_owned).ok_or_else(|| io::Error::other("no line for cgroup v2"))
    }

    fn name_of(&self, thread: &str) -> String {
        fs::read_to_string(format!("/proc/{thread}/comm"))
            .map_or_else(|_| "?".into(), |name| name.trim_end().to_owned())
    }

    fn refusal(&self, cpu: Cpu, cgroup: Option<&str>) -> io::Result<Option<io::Error>> {
        let entry = cgroup.map(|path| Entry::by(self.full_path(path).join("cgroup.threads")));
        refusal(cpu, entry)
    }

    fn pause(&self) {
        thread::sleep(PAUSE);
    }
}
