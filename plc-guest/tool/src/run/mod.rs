//! Runs a program on this machine.
//!
//! The program is native code for fixed addresses, so it runs as it is, in a process of its own that has
//! only the program mapped, at the addresses and with the rights that it has in the guest. That process is
//! traced, and `PTRACE_SYSEMU` makes each system call a stop that the kernel of this machine does not carry out:
//! whatever the program does, it can only compute, fault, or ask this tool. Syscall user dispatch with a
//! seccomp filter would be faster by some microseconds a call, but leaves the tool's memory in the program's reach.
//!
//! Time is simulated: tasks are released in the order of their release times and priorities, and each job runs to its
//! end. Preemption, budgets and waiting for another task are not simulated; they are the business of the guest and of
//! `takt check`.

mod caller;
mod child;
mod fault;
mod kernel;
mod machine;
mod memory;
mod outputs;
mod schedule;
mod simulation;

pub use fault::Failed;
pub use machine::Machine;
pub use schedule::{Logged, Schedule};
pub use simulation::{TestRun, Verdict};

/// Why a program cannot be run on this machine.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    #[error("{doing}: {source}")]
    Call { doing: &'static str, source: std::io::Error },
    #[error("the process for the program ended while it was set up (status {0:#x})")]
    SetUp(i32),
}

impl HostError {
    fn last(doing: &'static str) -> Self {
        Self::Call { doing, source: std::io::Error::last_os_error() }
    }
}
