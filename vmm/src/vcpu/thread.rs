//! Starting threads so that either all of them run or none does.
//!
//! Each thread does everything that can fail, reports, and then waits for the epoch. If one
//! fails, the others are let go without ever having entered their guest.
//!
//! The thread that starts it gives it its reservation, when all that is left for it is to wait. A budget
//! that is made for one kick in each period is too small for entering the sandbox: that would take many
//! periods, and SCHED_DEADLINE would throttle the thread at the epoch for what it used beyond the budget.

use std::convert::Infallible;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use kvm_ioctls::VcpuFd;
use takt_scheduler::enforce::{make_deadline, pin_to};
use takt_scheduler::reservation::Reservation;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Timebase};
use thiserror::Error;

use super::Control;
use super::kick::Kickable;
use crate::boot::touch::TouchError;
use crate::cpuset::Entry;
use crate::passthrough::real_ports::grant;
use crate::resctrl;
use crate::sandbox::{self, Kind, Mode, SandboxError};

/// All memory is locked, so a stack costs what it may grow to; these threads need little.
const STACK: usize = 128 * 1024;

/// What a thread needs that has no part in the schedule.
const fn stack(kind: Kind) -> usize {
    match kind {
        // Makes a machine, with KVM's tables on its stack.
        Kind::Loader => 256 * 1024,
        _ => 64 * 1024,
    }
}

/// What starts a thread of this name and kind that has no part in the schedule.
pub type Spawn<'a> = &'a dyn Fn(&str, Kind, Box<dyn FnOnce() + Send>) -> Result<(), ThreadError>;

/// Where and how a thread runs.
#[derive(Clone, Debug)]
pub struct Place {
    /// The only CPU it may use.
    pub cpu: Cpu,
    /// The scheduling domain of that CPU, if it has one of its own.
    pub domain: Option<Entry>,
    /// Its share of the cache and of the way to memory, if it has one of its own.
    pub group: Option<resctrl::Entry>,
    /// Its SCHED_DEADLINE reservation; `None` for the ordinary class.
    pub reservation: Option<Reservation>,
    /// Ranges of the host's I/O ports that it may use, both ends included.
    pub ports: Vec<[u16; 2]>,
    /// What it may do once it is ready.
    pub doors: (Kind, Mode),
}

/// A thread could not be made what it has to be.
#[derive(Debug, Error)]
pub enum ThreadError {
    /// The host gives no thread.
    #[error("cannot start thread {name}: {source}")]
    Spawn {
        /// The thread.
        name: String,
        /// What the host said.
        source: io::Error,
    },
    /// The thread could not enter its CPU's scheduling domain.
    #[error("thread {name} cannot enter the scheduling domain of CPU {cpu}: {source}; were Takt's cgroups changed?", cpu = cpu.0)]
    Enter {
        /// The thread.
        name: String,
        /// The CPU.
        cpu: Cpu,
        /// What the host said.
        source: io::Error,
    },
    /// The thread could not enter its group.
    #[error(
        "thread {name} cannot enter its group of the resctrl file system: {source}; were Takt's groups changed?"
    )]
    Group {
        /// The thread.
        name: String,
        /// What the host said.
        source: io::Error,
    },
    /// The thread could not be pinned.
    #[error("cannot pin thread {name} to CPU {cpu}: {source}; is that CPU online, in this process's cpuset, and in no cgroup takt-cpu{cpu} that a killed takt has left?", cpu = cpu.0)]
    Pin {
        /// The thread.
        name: String,
        /// The CPU.
        cpu: Cpu,
        /// What the host said.
        source: io::Error,
    },
    /// The thread could not become a deadline thread.
    #[error("cannot give thread {name} its SCHED_DEADLINE reservation of {} in {} on CPU {cpu}: {source}; {}", reservation.runtime, reservation.period, remedy(source), cpu = cpu.0)]
    Deadline {
        /// The thread.
        name: String,
        /// The CPU.
        cpu: Cpu,
        /// What was asked for.
        reservation: Reservation,
        /// What the host said.
        source: io::Error,
    },
    /// The thread got no privilege for its I/O ports.
    #[error(
        "thread {name} may not use the I/O ports {first:#x} to {last:#x}: {source}; this needs root (CAP_SYS_RAWIO), and a kernel with ioperm that is not locked down"
    )]
    Ports {
        /// The thread.
        name: String,
        /// The first of them.
        first: u16,
        /// The last of them.
        last: u16,
        /// What the host said.
        source: io::Error,
    },
    /// The thread could not be shut in.
    #[error("thread {name}: {source}")]
    Shut {
        /// The thread.
        name: String,
        /// What is refused.
        source: SandboxError,
    },
    /// The guest could not be made ready to start.
    #[error("thread {name} cannot make its guest ready: {source}")]
    Touch {
        /// The thread.
        name: String,
        /// Why not.
        source: TouchError,
    },
    /// KVM could not run the vCPU at all.
    #[error("thread {name} cannot run its vCPU: {source}")]
    Vcpu {
        /// The thread.
        name: String,
        /// What KVM said.
        source: kvm_ioctls::Error,
    },
    /// The thread ended before it could report.
    #[error("thread {name} died while starting")]
    Died {
        /// The thread.
        name: String,
    },
}

/// What to do about a refused reservation.
fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EPERM) => {
            "run as root (CAP_SYS_NICE); if this is root, the CPU's scheduling domain (cpuset.cpus.partition) was changed since Takt looked"
        }
        Some(libc::EBUSY) => {
            "the CPU's real-time bandwidth is taken: end other SCHED_DEADLINE threads or make the windows shorter"
        }
        Some(libc::EINVAL) => {
            "the host's bounds are in /proc/sys/kernel/sched_deadline_period_{min,max}_us"
        }
        _ => "see sched(7)",
    }
}

/// A thread that is ready and waits for the epoch. Dropping it ends the thread, and waits for that: what
/// a thread has of the host's devices cannot be given back before.
pub struct Ready<T> {
    waiting: Option<Waiting<T>>,
}

/// What a thread waits for: the epoch, or `None` if there will be none. It takes this when it has been shut
/// in already, so no channel: see [`crate::handoff`].
type Word = OnceLock<Option<Timebase>>;

struct Waiting<T> {
    start: Arc<Word>,
    handle: JoinHandle<Option<T>>,
    /// Its other end goes with the thread.
    gone: Receiver<Infallible>,
}

impl<T> Ready<T> {
    /// Lets it run.
    pub fn start(mut self, base: Timebase) -> Running<T> {
        let thread = self.waiting.take().map(|Waiting { start, handle, gone }| {
            // It is told once.
            let _ = start.set(Some(base));
            (handle, gone)
        });
        Running { thread }
    }
}

impl<T> Drop for Ready<T> {
    fn drop(&mut self) {
        if let Some(Waiting { start, handle, .. }) = self.waiting.take() {
            let _ = start.set(None);
            let _ = handle.join();
        }
    }
}

/// A thread that runs.
pub struct Running<T> {
    thread: Option<(JoinHandle<Option<T>>, Receiver<Infallible>)>,
}

impl<T> Running<T> {
    /// Waits for its end; `None` if it did not get to run.
    pub fn join(self) -> Option<T> {
        let (handle, _) = self.thread?;
        handle.join().ok().flatten()
    }

    /// Waits for its end, but no longer than this. False if it has not come; then the thread is left to
    /// what it does, for as long as the process lives.
    pub fn join_within(self, time: Duration) -> bool {
        let Some((handle, gone)) = self.thread else { return true };
        if gone.recv_timeout(time) == Err(RecvTimeoutError::Timeout) {
            return false;
        }
        let _ = handle.join();
        true
    }
}

/// Starts a thread that runs a vCPU, once `ready` has made it ready.
///
/// # Errors
/// See [`ThreadError`].
pub fn vcpu<T: Send + 'static>(
    name: &str,
    place: Place,
    control: Arc<Control>,
    vcpu: VcpuFd,
    ready: impl FnOnce(&mut VcpuFd) -> Result<(), TouchError> + Send + 'static,
    body: impl FnOnce(&mut Kickable, Timebase) -> T + Send + 'static,
) -> Result<Ready<T>, ThreadError> {
    let failed = name.to_owned();
    let prepare = move || {
        let mut kickable = Kickable::new(vcpu);
        if let Err(source) = ready(kickable.vcpu()) {
            return Err(ThreadError::Touch { name: failed, source });
        }
        kickable.prime().map_err(|source| ThreadError::Vcpu { name: failed, source })?;
        Ok(kickable)
    };
    spawn(name, place, control, prepare, |mut kickable, base| body(&mut kickable, base))
}

/// Starts a thread that runs no vCPU.
///
/// # Errors
/// See [`ThreadError`].
pub fn plain<T: Send + 'static>(
    name: &str,
    place: Place,
    control: Arc<Control>,
    body: impl FnOnce(Timebase) -> T + Send + 'static,
) -> Result<Ready<T>, ThreadError> {
    spawn(name, place, control, || Ok(()), |(), base| body(base))
}

/// Starts a thread of the ordinary class that is bound to no CPU, has no part in the schedule, and is
/// never joined; returns when it is shut in.
///
/// # Errors
/// See [`ThreadError`].
pub fn detached(
    name: &str,
    doors: (Kind, Mode),
    body: impl FnOnce() + Send + 'static,
) -> Result<(), ThreadError> {
    let own = name.to_owned();
    alone(name, doors.0, move || shut_in(&own, doors), body)
}

/// The same, bound to a CPU.
///
/// # Errors
/// See [`ThreadError`].
pub fn detached_at(
    name: &str,
    place: Place,
    body: impl FnOnce() + Send + 'static,
) -> Result<(), ThreadError> {
    let (own, doors) = (name.to_owned(), place.doors);
    alone(name, doors.0, move || pin(&own, &place).and_then(|()| shut_in(&own, doors)), body)
}

fn alone(
    name: &str,
    kind: Kind,
    ready: impl FnOnce() -> Result<(), ThreadError> + Send + 'static,
    body: impl FnOnce() + Send + 'static,
) -> Result<(), ThreadError> {
    let (report, reported) = channel();
    let run = move || {
        let ready = ready();
        let failed = ready.is_err();
        if report.send(ready).is_ok() && !failed {
            body();
        }
    };
    let name = || name.to_owned();
    Builder::new()
        .name(name())
        .stack_size(stack(kind))
        .spawn(run)
        .map_err(|source| ThreadError::Spawn { name: name(), source })?;
    reported.recv().unwrap_or_else(|_| Err(ThreadError::Died { name: name() }))
}

fn spawn<P, T: Send + 'static>(
    name: &str,
    place: Place,
    control: Arc<Control>,
    prepare: impl FnOnce() -> Result<P, ThreadError> + Send + 'static,
    body: impl FnOnce(P, Timebase) -> T + Send + 'static,
) -> Result<Ready<T>, ThreadError> {
    let (report, reported) = channel();
    let start = Arc::<Word>::default();
    let started = start.clone();
    let thread_name = name.to_owned();
    let own = control.clone();
    let (alive, gone) = channel();
    let Place { cpu, reservation, .. } = place;
    let run = move || {
        let _alive = alive;
        own.is_this_thread();
        let prepared = pin(&thread_name, &place)
            .and_then(|()| allow_ports(&thread_name, &place))
            .and_then(|()| prepare())
            .and_then(|p| shut_in(&thread_name, place.doors).map(|()| p));
        match prepared {
            Err(error) => {
                let _ = report.send(Err(error));
                None
            }
            Ok(prepared) => {
                report.send(Ok(())).ok()?;
                let base = (*started.wait())?;
                Some(body(prepared, base))
            }
        }
    };
    let handle = Builder::new()
        .name(name.to_owned())
        .stack_size(STACK)
        .spawn(run)
        .map_err(|source| ThreadError::Spawn { name: name.to_owned(), source })?;
    match reported.recv() {
        Ok(Ok(())) => {
            // Refused, it lets the thread go.
            let ready = Ready { waiting: Some(Waiting { start, handle, gone }) };
            reserve(name, control.thread(), cpu, reservation).map(|()| ready)
        }
        Ok(Err(error)) => {
            let _ = handle.join();
            Err(error)
        }
        Err(_) => Err(ThreadError::Died { name: name.to_owned() }),
    }
}

/// Moves the calling thread to its place.
pub(crate) fn pin(name: &str, place: &Place) -> Result<(), ThreadError> {
    if let Some(domain) = &place.domain {
        domain.enter().map_err(|source| ThreadError::Enter {
            name: name.to_owned(),
            cpu: place.cpu,
            source,
        })?;
    }
    if let Some(group) = &place.group {
        let failed = |source| ThreadError::Group { name: name.to_owned(), source };
        group.enter().map_err(failed)?;
    }
    pin_to(place.cpu).map_err(|source| ThreadError::Pin {
        name: name.to_owned(),
        cpu: place.cpu,
        source,
    })
}

/// Once, and for these only: the thread can never get at others.
fn allow_ports(name: &str, place: &Place) -> Result<(), ThreadError> {
    place.ports.iter().try_for_each(|&[first, last]| {
        grant(first, last).map_err(|source| ThreadError::Ports {
            name: name.to_owned(),
            first,
            last,
            source,
        })
    })
}

fn reserve(
    name: &str,
    thread: i32,
    cpu: Cpu,
    reservation: Option<Reservation>,
) -> Result<(), ThreadError> {
    let Some(reservation) = reservation else { return Ok(()) };
    make_deadline(thread, reservation).map_err(|source| ThreadError::Deadline {
        name: name.to_owned(),
        cpu,
        reservation,
        source,
    })
}

/// After all that needs a privilege.
fn shut_in(name: &str, (kind, mode): (Kind, Mode)) -> Result<(), ThreadError> {
    sandbox::enter(kind, mode, name, &[])
        .map(drop)
        .map_err(|source| ThreadError::Shut { name: name.to_owned(), source })
}

/// Clock of a thread's CPU time: `make_thread_cpuclock(tid, CPUCLOCK_SCHED)` in the kernel's
/// `include/linux/posix-timers.h`.
const fn cpu_clock(thread: i32) -> libc::clockid_t {
    const PER_THREAD: i32 = 4;
    const SCHED: i32 = 2;
    !thread << 3 | PER_THREAD | SCHED
}

/// CPU time that a thread of this process has used since it started; `None` if it is gone.
pub(super) fn cpu_time_of(thread: i32) -> Option<Nanos> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills in a live timespec; an unknown clock is refused.
    let result = unsafe { libc::clock_gettime(cpu_clock(thread), &raw mut time) };
    (result == 0).then(|| Nanos(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64))
}

/// CPU time that the calling thread has used since it started.
#[must_use]
pub fn cpu_time() -> Nanos {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills in a live timespec; cannot fail for the calling thread's own clock.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    Nanos(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_thread_is_known_to_others_until_it_is_gone() {
        let (tell, told) = channel();
        let (end, ended) = channel::<()>();
        let thread = std::thread::spawn(move || {
            let before = cpu_time();
            tell.send((crate::vcpu::kick::this_thread(), before)).unwrap();
            let _ = ended.recv();
        });
        let (id, before) = told.recv().unwrap();
        assert!(cpu_time_of(id).unwrap() >= before);
        drop(end);
        thread.join().unwrap();
        assert_eq!(cpu_time_of(i32::MAX >> 3), None);
    }

    #[test]
    fn what_a_thread_has_is_free_when_it_has_not_got_to_run() {
        let devices = Arc::new(());
        let own = devices.clone();
        let start = Arc::<Word>::default();
        let started = start.clone();
        let handle = std::thread::spawn(move || {
            let base = (*started.wait())?;
            drop(own);
            Some(base)
        });
        let (_, gone) = channel();
        drop(Ready { waiting: Some(Waiting { start, handle, gone }) });
        assert_eq!(Arc::strong_count(&devices), 1);
    }
}
