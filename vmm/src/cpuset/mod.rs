//! Scheduling domains for CPUs with windows, made before a run and gone after it.
//!
//! SCHED_DEADLINE admits bandwidth for a whole *root domain*, the CPUs among which the kernel
//! balances load. A thread that is pinned to fewer CPUs than that breaks the sum, so the kernel
//! refuses it (`EPERM`; `kernel/sched/core.c`, "the affinity is as large as the root_domain").
//! Takt pins every thread: on a host with several CPUs, each CPU with windows needs a root domain
//! of its own.
//!
//! Whether one is needed is found by trying, since there are many ways to have it already (one CPU,
//! `isolcpus`, an administrator's cpuset, admission control switched off): a throw-away thread
//! pins itself and asks for a small reservation (`kernel`). Where it is refused, `setup` makes
//! a cgroup v2 cpuset of that CPU and turns it into a *partition*, which is what makes the kernel
//! cut out a root domain (`Documentation/admin-guide/cgroup-v2.rst`, "cpuset.cpus.partition").
//!
//! ```text
//!  /sys/fs/cgroup             cpuset.cpus.effective: what is left      main, Linux on CPU 0
//!   +-- takt-cpu1  threaded   cpuset.cpus: 1, partition: root          plc, kicker-1
//!   +-- takt-cpu2  threaded   cpuset.cpus: 2, partition: root          plc-b, kicker-2, linux-b
//! ```
//!
//! The cgroups are *threaded*, because the threads of one process go to several of them. A thread
//! can only move within one threaded domain, and that of `takt-cpuN` is the root cgroup, the only
//! one that may have threads and other children at once. A process that is elsewhere, as all are
//! under systemd, is therefore moved to the root cgroup for the run and back afterwards. Making
//! the partitions below the place where it was found instead would need every cgroup on the way up
//! to be a partition too (before Linux 6.7), and to have no processes of its own: more of the
//! host's arrangement would change, not less.
//!
//! One CPU always stays with the root cgroup, or its processes would have none. If all CPUs of the
//! host have windows, that is the lowest one: when the others are cut out it is alone in the root
//! domain, which is as good.
//!
//! cgroup v1 is refused: there, the same takes switching off load balancing for the whole host.
//!
//! What a run cannot help: before Linux 6.2, changing the root set overwrites affinities that
//! other processes have set for themselves (`taskset`).

mod kernel;
mod setup;
mod watch;

use std::fs::TryLockError;
use std::io::{self, Write};
use std::path::PathBuf;

use takt_scheduler::schedules::Schedules;
use takt_scheduler::table::Cpu;
use thiserror::Error;

pub use kernel::Entry;
use kernel::refusal;
use setup::Setup;
use takt_host::mounts;
pub use takt_host::mounts::HierarchyError;
pub use watch::DomainWatch;

use crate::kernel_tree::LockedTree;
use crate::outlet::last_line;

/// CPUs could not be given scheduling domains of their own.
#[derive(Debug, Error)]
pub enum CpusetError {
    /// The host gives no thread to try a reservation on.
    #[error("cannot start a thread to try a reservation: {0}")]
    Thread(io::Error),
    /// A domain is needed, but there is nothing to make it with.
    #[error("CPU {cpu} needs a scheduling domain of its own (a pinned deadline thread is refused: {refused}), but {source}", cpu = cpu.0)]
    Hierarchy {
        /// The first CPU that needs one.
        cpu: Cpu,
        /// What the kernel said to a pinned deadline thread.
        refused: io::Error,
        /// What is missing.
        source: HierarchyError,
    },
    /// The kernel refuses a step.
    #[error("cannot {what} {path}: {source}{}", remedy(source))]
    Step {
        /// What was attempted.
        what: &'static str,
        /// On which file or folder.
        path: String,
        /// What the kernel said.
        source: io::Error,
    },
    /// The folder for a CPU is there and has threads.
    #[error(
        "{path} is in use by {users}: another takt or an administrator has this CPU; end that first"
    )]
    InUse {
        /// The folder.
        path: String,
        /// Ids and names of the threads.
        users: String,
    },
    /// The CPU cannot be taken from the root set.
    #[error("CPU {cpu} cannot be set apart: the root cgroup has only CPUs {effective}; is CPU {cpu} online, and in no other cpuset partition?", cpu = cpu.0)]
    NotInRoot {
        /// The CPU.
        cpu: Cpu,
        /// CPUs of the root cgroup.
        effective: String,
    },
    /// The kernel took the request and calls the result invalid.
    #[error("the kernel makes no scheduling domain for CPU {cpu}: {path} reads \"{state}\"; no other cgroup's cpuset.cpus may name this CPU", cpu = cpu.0)]
    Invalid {
        /// The CPU.
        cpu: Cpu,
        /// The file that tells.
        path: String,
        /// State and reason, in the kernel's words.
        state: String,
    },
    /// The domain is there and does not help.
    #[error("even set apart, CPU {cpu} takes no pinned deadline thread: {source}; is this root (CAP_SYS_NICE)? is the CPU in isolcpus with others?", cpu = cpu.0)]
    StillRefused {
        /// The CPU.
        cpu: Cpu,
        /// What the kernel said.
        source: io::Error,
    },
    /// All was undone, and yet the CPU has not come back.
    #[error("CPU {cpu} has not come back: the root cgroup has only CPUs {effective}", cpu = cpu.0)]
    NotBack {
        /// The CPU.
        cpu: Cpu,
        /// CPUs of the root cgroup.
        effective: String,
    },
    /// Setting up failed, and then undoing what was done of it.
    #[error("{error}; and what was done until then could not be undone: {undo}")]
    AndNotUndone {
        /// Why setting up failed.
        error: Box<CpusetError>,
        /// Why undoing failed.
        undo: Box<CpusetError>,
    },
}

fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => "; run as root",
        Some(libc::EROFS) => "; in a container, mount the host's cgroup2 file system writable",
        _ => "",
    }
}

/// The host's cgroup v2 hierarchy, kept from other Takts.
fn find() -> Result<LockedTree, HierarchyError> {
    let path = mounts::find()?;
    LockedTree::open(path.clone()).map_err(|error| match error {
        TryLockError::WouldBlock => HierarchyError::Locked { path },
        TryLockError::Error(source) => HierarchyError::Read { path, source },
    })
}

/// The scheduling domains of a run. Dropping it gives the CPUs back; threads that are in a domain
/// must have ended, or be about to.
#[derive(Default)]
pub struct Domains {
    setup: Option<Setup<LockedTree>>,
}

impl Domains {
    /// Makes sure that each CPU with windows takes pinned deadline threads, and tells what it did.
    /// Either all of them do afterwards, or nothing is changed.
    ///
    /// # Errors
    /// See [`CpusetError`].
    pub fn set_up(schedules: &Schedules) -> Result<Self, CpusetError> {
        let mut needed = Vec::new();
        let mut first = None;
        for cpu in schedules.cpus() {
            if schedules.timetable_on(cpu).is_none() {
                continue;
            }
            if let Some(refused) = refusal(cpu, None).map_err(CpusetError::Thread)? {
                needed.push(cpu);
                first.get_or_insert((cpu, refused));
            }
        }
        let Some((cpu, refused)) = first else { return Ok(Self::default()) };
        let kernel = find().map_err(|source| CpusetError::Hierarchy { cpu, refused, source })?;
        let setup = Setup::make(kernel, &needed)?;
        for Cpu(cpu) in setup.own() {
            tell(&format!("CPU {cpu} has a scheduling domain of its own"));
        }
        if let Some(Cpu(cpu)) = setup.left() {
            tell(&format!("CPU {cpu} is left alone in the host's scheduling domain"));
        }
        Ok(Self { setup: Some(setup) })
    }

    /// The folder of the root cgroup, if anything in it is to be undone.
    #[must_use]
    pub fn root(&self) -> Option<PathBuf> {
        self.setup.as_ref().map(Setup::root)
    }

    /// What notices later that the kernel has dissolved one of them.
    #[must_use]
    pub fn watch(&self) -> DomainWatch {
        DomainWatch::open(self.setup.iter().flat_map(Setup::partitions))
    }

    /// What a thread must enter before it is pinned to `cpu`; `None` if it may stay where it is.
    #[must_use]
    pub fn entry(&self, cpu: Cpu) -> Option<Entry> {
        self.setup.as_ref().and_then(|setup| setup.entry(cpu))
    }
}

impl Drop for Domains {
    fn drop(&mut self) {
        let Some(setup) = &mut self.setup else { return };
        match setup.undo() {
            Ok(cpus) => {
                for Cpu(cpu) in cpus {
                    tell_last(&format!("CPU {cpu} is back in the host's scheduling domain"));
                }
            }
            // The run is over and its report is good: this is told, and its status stays.
            Err(error) => tell_last(&format!(
                "the host's scheduling domains are not as they were: {error}; the next run with this file, or a restart, removes what is left"
            )),
        }
    }
}

fn tell_last(text: &str) {
    last_line(&mut io::stdout(), text);
}

/// A line to the user, who may have gone.
fn tell(text: &str) {
    let _ = writeln!(io::stdout(), "[takt] {text}");
}
