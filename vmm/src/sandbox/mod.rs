//! Closing the doors of the process.
//!
//! Takt starts with all the power of root, since making partitions needs it, and afterwards hardly
//! any. A guest that finds an error in Takt, or in KVM behind one of its calls, should find a
//! process that can do nothing with the host. So each thread gives its power away when it has what
//! it needs, and before any guest instruction: all capabilities, all paths of the file system but
//! those that have to be given back at the end, and all system calls but the few of its kind.
//!
//! ```text
//! process   no core dump, not traceable, only the descriptors that it has made itself
//! thread    take what is needed --> no new privileges --> no capability --> Landlock --> filter
//! ```
//!
//! It is done by each thread for itself, the supervisor thread last: what one needs for its start, such
//! as a reservation, would be refused to it otherwise. The threads share their memory, so this is
//! no wall between them, but one between Takt and the host.
//!
//! A mount namespace without files would be the older way to leave the file system. It needs a
//! privilege of its own, and could not leave a folder of the host's in sight to which something is
//! to be given back; Landlock can, path by path, and needs none.
//!
//! `docs/security.md` says what may come through which door.

pub mod descriptors;
pub mod files;
pub mod filter;
pub mod privileges;
pub mod violation;

use std::io;

use thiserror::Error;

pub use files::Allowed;
pub use filter::{Kind, Mode};

/// The host refuses to take something away.
#[derive(Debug, Error)]
#[error("cannot {what}: {source}")]
pub struct SandboxError {
    /// What was attempted.
    what: &'static str,
    /// What the host said.
    source: io::Error,
}

fn cannot(what: &'static str) -> impl FnOnce(io::Error) -> SandboxError {
    move |source| SandboxError { what, source }
}

/// What no thread of the process needs, from its start on. `emergency_stop` is done before a forbidden
/// system call ends the process, and tells whether all of it is; it must be safe in a signal handler.
///
/// # Errors
/// See [`SandboxError`].
pub fn prepare(emergency_stop: fn() -> Option<bool>) -> Result<(), SandboxError> {
    privileges::keep_memory_private().map_err(cannot("keep the process's memory to itself"))?;
    violation::leave_faults_to_the_kernel();
    violation::install(emergency_stop)
        .map_err(cannot("install the handler of forbidden system calls"))
}

/// Shuts the calling thread in for the rest of its life: it goes on without privileges, with the
/// paths of `allowed` and the system calls of its kind. Tells whether the paths could be taken,
/// which a kernel without Landlock cannot.
///
/// # Errors
/// See [`SandboxError`].
pub fn enter(
    kind: Kind,
    mode: Mode,
    name: &str,
    allowed: &[Allowed],
) -> Result<bool, SandboxError> {
    violation::set_name(name);
    let needed = allowed.iter().fold(0, |kept, allowed| kept | allowed.capability());
    let kept = if kind == Kind::Guardian { privileges::SYS_RAWIO } else { needed };
    privileges::drop_all(kept).map_err(cannot("give up privileges"))?;
    let restricted = files::restrict(allowed).map_err(cannot("leave the file system"))?;
    filter::install(kind, mode).map_err(cannot("install the filter of system calls"))?;
    Ok(restricted)
}

/// Leaves to process 1 of the appliance, which has started the run and only waits for its end, what it
/// needs after that: one port, a machine to switch off, and the paths of `allowed`. It has no filter: it
/// handles nothing that a guest could have touched until there are no guests any more, and a process 1
/// that is ended takes the results with it.
///
/// # Errors
/// See [`SandboxError`].
pub fn enter_as_first(allowed: &[Allowed]) -> Result<(), SandboxError> {
    privileges::keep_memory_private().map_err(cannot("keep the process's memory to itself"))?;
    privileges::drop_all(privileges::SYS_RAWIO | privileges::SYS_BOOT)
        .map_err(cannot("give up privileges"))?;
    files::restrict(allowed).map(drop).map_err(cannot("leave the file system"))
}
