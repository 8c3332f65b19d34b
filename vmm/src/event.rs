//! Event descriptors, by which threads wake each other and KVM wakes them.

use std::io;

use thiserror::Error;
use vmm_sys_util::eventfd::{EFD_CLOEXEC, EFD_NONBLOCK, EventFd};

/// The host has none to give.
#[derive(Debug, Error)]
#[error("cannot {what} an event descriptor: {source}")]
pub struct EventError {
    what: &'static str,
    source: io::Error,
}

impl From<EventError> for io::Error {
    fn from(error: EventError) -> Self {
        error.source
    }
}

/// A new one. A read before the first write is refused, and does not wait.
///
/// # Errors
/// What the host says.
pub fn eventfd() -> Result<EventFd, EventError> {
    EventFd::new(EFD_NONBLOCK | EFD_CLOEXEC).map_err(|source| EventError { what: "make", source })
}

/// A second handle of one.
///
/// # Errors
/// What the host says.
pub fn clone(fd: &EventFd) -> Result<EventFd, EventError> {
    fd.try_clone().map_err(|source| EventError { what: "copy", source })
}
