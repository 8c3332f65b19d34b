//! Why there can be no supervisor thread, or no longer.

use std::io;

use thiserror::Error;

/// The supervisor thread could not be set up or lost its events.
#[derive(Debug, Error)]
pub enum SupervisorError {
    /// The host refuses a descriptor.
    #[error("cannot {what}: {source}")]
    Host {
        /// What was attempted.
        what: &'static str,
        /// What the host said.
        source: io::Error,
    },
    /// The event loop failed.
    #[error("the event loop failed: {0}")]
    Events(event_manager::Error),
}

pub(super) fn cannot(what: &'static str) -> impl FnOnce(io::Error) -> SupervisorError {
    move |source| SupervisorError::Host { what, source }
}
