//! Why a partition does not get the interrupts of its devices.

use std::io;

use thiserror::Error;

use crate::machine::MachineError;

/// Interrupts could not be connected.
#[derive(Debug, Error)]
pub enum InterruptError {
    /// KVM refuses.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// The host refuses.
    #[error("cannot {what}: {source}")]
    Host {
        /// What was attempted.
        what: &'static str,
        /// What the host said.
        source: io::Error,
    },
}
