//! Why a partition does not get a disk.

use std::io;

use thiserror::Error;

use super::DiskFileError;
use crate::event::EventError;
use crate::machine::MachineError;
use crate::memory::MemoryError;
use crate::vcpu::thread::ThreadError;

/// A disk could not be made.
#[derive(Debug, Error)]
pub enum DiskError {
    /// Its file is of no use: the user's to mend.
    #[error(transparent)]
    File(#[from] DiskFileError),
    /// The descriptor that the guest rings.
    #[error("cannot make an event descriptor: {0}")]
    Bell(io::Error),
    /// Another descriptor.
    #[error(transparent)]
    Event(#[from] EventError),
    /// The memory that it reads and writes.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// Its registers.
    #[error(transparent)]
    Registers(#[from] MachineError),
    /// Its thread.
    #[error(transparent)]
    Thread(#[from] ThreadError),
}
