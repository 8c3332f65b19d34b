//! What the loops that run a vCPU know of the guest in it.

use std::fmt;

use kvm_bindings::KVM_EXIT_X86_BUS_LOCK;
use kvm_ioctls::VcpuExit;
use takt_abi::{Exception, exception_name};
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Release, Slot};

use super::guest_timer::GuestTimer;
use super::port_access::PortAccess;
use super::record::Scan;
use crate::boot::StartMode;
use crate::health::Detail;
use crate::sandbox;

/// Why a guest runs no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Takt ended the run.
    Stopped,
    /// The guest switched itself off.
    PoweredOff,
    /// A switch of the schedule asks for a new start of this partition.
    ScheduleChange(StartMode),
    /// A PLC guest ended itself with an exit code.
    Exited(u32),
    /// A PLC guest reported an exception.
    Exception(Exception),
    /// An error that the guest could have survived, but for the health monitor's table.
    Raised(Detail),
    /// The guest asked to be restarted.
    Reset,
    /// The guest's watchdog has expired: there was no heartbeat for this long.
    Silent(Nanos),
    /// The processor shut down: an exception while handling a double fault.
    TripleFault,
    /// A guest without interrupts halted: it would never wake up.
    Halted,
    /// KVM could not go on with this guest.
    Kvm(KvmFailure),
    /// It was to be started anew and could not be loaded.
    NotLoaded,
}

/// How KVM gave up on a guest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KvmFailure {
    /// The processor refused to enter the guest, with its reason.
    Entry(u64),
    /// KVM could not emulate an instruction, or met a state it does not know.
    Internal,
    /// An exit that no guest of this kind should cause.
    UnexpectedExit,
    /// `KVM_RUN` failed with this `errno`.
    Errno(i32),
}

impl End {
    /// True if the partition did not end as it should.
    #[must_use]
    pub const fn is_failure(&self) -> bool {
        !matches!(self, End::Stopped | End::PoweredOff | End::Exited(0) | End::ScheduleChange(_))
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            End::Stopped => f.write_str("stopped by takt"),
            End::PoweredOff => f.write_str("powered off"),
            End::ScheduleChange(StartMode::Cold) => f.write_str("cold start for the new schedule"),
            End::ScheduleChange(StartMode::Warm) => f.write_str("warm start for the new schedule"),
            End::Exited(code) => write!(f, "ended itself with code {code}"),
            End::Exception(e) => {
                let name = exception_name(e.vector).unwrap_or("reserved vector");
                write!(
                    f,
                    "{name} (vector {}, error code {:#x}) at rip {:#x}, rsp {:#x}, rflags {:#x}, cr2 {:#x}",
                    e.vector, e.error_code, e.rip, e.rsp, e.rflags, e.cr2
                )
            }
            End::Raised(detail) => detail.fmt(f),
            End::Reset => f.write_str("asked for a restart"),
            End::Silent(time) => write!(f, "no heartbeat for {time}"),
            End::TripleFault => f.write_str("triple fault"),
            End::Halted => f.write_str("halted with no interrupt that could wake it"),
            End::Kvm(KvmFailure::Entry(reason)) => {
                write!(f, "the processor refused to enter the guest (reason {reason:#x})")
            }
            End::Kvm(KvmFailure::Internal) => f.write_str("KVM internal error"),
            End::Kvm(KvmFailure::UnexpectedExit) => f.write_str("unexpected exit from KVM"),
            End::Kvm(KvmFailure::Errno(errno)) => {
                write!(f, "KVM_RUN failed: {}", std::io::Error::from_raw_os_error(*errno))
            }
            End::NotLoaded => f.write_str("could not be loaded again"),
        }
    }
}

/// What follows from an exit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Back into the guest.
    Resume,
    /// The guest gives the rest of its window away.
    Done,
    /// The guest reports an error, and goes on if it may.
    Raised(Detail),
    /// The guest runs no more.
    Ended(End),
}

/// A guest, as seen by the thread that runs its vCPU.
pub trait Guest {
    /// What its thread may do.
    const THREAD: sandbox::Kind;

    /// Tells the guest of the window that comes, and of what comes after it.
    fn announce(&mut self, release: &Release, next: &Slot, base: &Timebase);

    /// Answers an exit.
    fn handle(&mut self, exit: VcpuExit<'_>) -> Step;

    /// Whether accesses to this port are the guest's to make, by [`access`](Self::access) and not
    /// by [`handle`](Self::handle).
    fn has_port(&self, _port: u16) -> bool {
        false
    }

    /// Makes an access to a port of the guest's.
    fn access(&mut self, _access: PortAccess<'_>) -> Step {
        Step::Resume
    }

    /// Ranges of the host's ports that the guest's thread needs for that, both ends included.
    fn io_ranges(&self) -> Vec<[u16; 2]> {
        Vec::new()
    }

    /// The guest's timer, if its deadlines are Takt's to place.
    fn timer(&mut self) -> Option<&mut GuestTimer> {
        None
    }

    /// How the guest is to end, if something else than an exit of its own says so.
    fn ended_from_outside(&self) -> Option<End> {
        None
    }

    /// The guest does not run any more, unless it is loaded anew. To be told on its own thread.
    fn left(&mut self) {}

    /// What the guest claims of the release with this sequence number, or `None` if it does not
    /// claim to have started it. A claim, not a fact.
    fn claim(&self, sequence: u64) -> Option<Scan>;

    /// The guest's last time stamp of all, of whatever release. A claim.
    fn last_stamp(&self) -> Tsc;

    /// True if the guest is expected to say "done" in each window. One that is not simply uses
    /// all of its windows, and their ends are no overruns.
    fn says_done(&self) -> bool;

    /// The vector with which the guest wants its windows to begin, after those in which it was not done.
    /// What it has not done then may wait: see [`WindowRecord::unfinished`](super::record::WindowRecord).
    fn tick(&self) -> Option<u8> {
        None
    }

    /// Accesses to ports and memory that nothing answers.
    fn illegal_accesses(&self) -> u64;
}

/// The exits that mean the same for every guest.
pub(super) fn handle_common(exit: &VcpuExit<'_>) -> Step {
    Step::Ended(match exit {
        // The health monitor looks for bus locks at every exit, whatever it is.
        VcpuExit::Unsupported(KVM_EXIT_X86_BUS_LOCK) => return Step::Resume,
        VcpuExit::Hlt => End::Halted,
        VcpuExit::Shutdown => End::TripleFault,
        VcpuExit::FailEntry(reason, _) => End::Kvm(KvmFailure::Entry(*reason)),
        VcpuExit::InternalError => End::Kvm(KvmFailure::Internal),
        _ => End::Kvm(KvmFailure::UnexpectedExit),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_orderly_end_is_no_failure() {
        for good in [End::Stopped, End::PoweredOff, End::Exited(0)] {
            assert!(!good.is_failure());
        }
        for bad in [End::Exited(1), End::Reset, End::TripleFault, End::Halted] {
            assert!(bad.is_failure());
        }
    }

    #[test]
    fn an_exit_for_a_bus_lock_goes_on_and_an_unknown_one_does_not() {
        let exit = VcpuExit::Unsupported(KVM_EXIT_X86_BUS_LOCK);
        assert_eq!(handle_common(&exit), Step::Resume);
        let end = Step::Ended(End::Kvm(KvmFailure::UnexpectedExit));
        assert_eq!(handle_common(&VcpuExit::Unsupported(0)), end);
    }

    #[test]
    fn an_exception_is_told_with_its_frame() {
        let exception = Exception {
            vector: 14,
            error_code: 2,
            rip: 0x10_0040,
            rsp: 0x20_0000,
            rflags: 2,
            cr2: 0,
        };
        let text = End::Exception(exception).to_string();
        assert!(
            text.starts_with("page fault (vector 14, error code 0x2) at rip 0x100040"),
            "{text}"
        );
    }
}
