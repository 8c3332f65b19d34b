//! A disk for a Linux guest: a virtio block device (virtio 1.2, section 5.2) behind virtio's
//! memory-mapped registers ([`virtio`](crate::virtio)).
//!
//! What is the guest's and what is the disk's are two threads. The guest's reads and writes of
//! registers are few and cheap, and are answered where they are made, on the thread of its vCPU.
//! Requests wait for a file, so they are served on a thread of the disk's own, of SCHED_OTHER:
//! no window waits for a file.
//!
//! ```text
//!   vCPU's thread                                       disk's thread
//!   device::DiskDevice --> handover::Handover <-- server::Server --> Medium
//!                                queue              request::Request
//! ```
//!
//! Between them is one queue that changes hands ([`handover`]). The disk's thread holds it by a lease,
//! which a reset ends at once, and touches the guest's memory only while the lease holds: it copies
//! between that and a buffer of its own, so that a slow file holds up only the disk.
//!
//! All that a guest writes is hostile: registers, rings, descriptors and what they point at. The
//! rules, of which each has a test that drives the rings by hand:
//!
//! - only memory that the server was given is ever touched, which is the guest's RAM;
//! - one notification is one queue's worth of work at most, and a request at most
//!   [`SEGMENTS_MAX`] pieces of [`SEGMENT_BYTES_MAX`];
//! - a request that makes no sense is answered with an error if it has a place for the answer.
//!   Where it has none, or the rings themselves are nonsense, the device stops and says that it
//!   needs a reset.

pub mod device;
pub mod handover;
pub mod request;
pub mod server;
#[cfg(test)]
mod tests;
mod transfer;

use std::io;

/// Unit of all addresses on a disk, in bytes; virtio's own, whatever the file has.
pub const SECTOR: u64 = 512;
/// Entries of the queue.
pub const QUEUE_SIZE: u16 = 256;
/// Most pieces of memory in one request: what the queue holds beside header and status.
pub const SEGMENTS_MAX: usize = QUEUE_SIZE as usize - 2;
/// Longest piece, in bytes.
pub const SEGMENT_BYTES_MAX: u32 = 1 << 16;

/// Most sectors that one request discards: 1 GiB.
pub const DISCARD_SECTORS_MAX: u32 = 1 << 21;
/// In what units a file gives space back, in sectors: blocks of 4 KiB. Less than one is only cleared.
pub const DISCARD_ALIGNMENT: u32 = 8;

/// Most bytes that are moved at once between the guest's memory and the medium.
pub const PIECE_BYTES: usize = 128 << 10;
/// What the medium's part of a transfer is aligned to in memory, in bytes, so that a file can take it past its page cache.
pub const BUFFER_ALIGNMENT: usize = 4096;

/// What a disk is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Its size.
    pub sectors: u64,
    /// Whether nothing on it may change.
    pub read_only: bool,
}

/// Where a disk's bytes are. Buffers are aligned to [`BUFFER_ALIGNMENT`]. Positions and lengths are whole sectors within its [`Shape`], no
/// transfer is longer than [`PIECE_BYTES`], and none is empty. Each call may take as long as it takes.
pub trait Medium: Send {
    /// Fills `into` from `at`, in bytes.
    ///
    /// # Errors
    /// If not all of it can be read.
    fn read(&mut self, at: u64, into: &mut [u8]) -> io::Result<()>;

    /// Writes `from` to `at`, in bytes.
    ///
    /// # Errors
    /// If not all of it can be written.
    fn write(&mut self, at: u64, from: &[u8]) -> io::Result<()>;

    /// Gives back the space behind these bytes; what is read there afterwards is zeros.
    ///
    /// # Errors
    /// [`Unsupported`](io::ErrorKind::Unsupported) if the medium keeps all space, or why else not.
    fn discard(&mut self, at: u64, bytes: u64) -> io::Result<()>;

    /// Returns when all that was written survives a loss of power.
    ///
    /// # Errors
    /// If it may not.
    fn flush(&mut self) -> io::Result<()>;
}
