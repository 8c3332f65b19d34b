//! The memory that both ends share: a queue of frames for each direction.
//!
//! The queues are those of `takt-channel`, which are made for ends that do not trust each other. Outside the memory
//! is a file, inside it is a base address of a PCI function.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;

use takt_channel::{
    Geometry, GeometryError, Misaligned, OpenError, OwnPages, PeerPages, Policy,
    QueuingDestination, QueuingSource, Tsc,
};
use thiserror::Error;
use vm_memory::FileOffset;
use vm_memory::mmap::{MmapRegion, MmapRegionError};

use crate::frame::{Frame, MESSAGE_MAX};

/// Length of the memory, a power of two as that of each base address.
pub const BYTES: usize = 1 << 20;
/// Frames that can wait in each direction.
const DEPTH: u32 = 64;
/// Regions begin at multiples of this.
const PAGE: usize = 4096;

/// An end of the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// On the user's machine.
    Outside,
    /// In the emulated machine.
    Inside,
}

/// Why there is no line.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum LineError {
    #[error("cannot {what} the line {}: {source}", path.display())]
    File { what: &'static str, path: PathBuf, source: io::Error },
    #[error("cannot map the line {}: {source}", path.display())]
    Map { path: PathBuf, source: MmapRegionError },
    #[error("the line {} has less than {BYTES} bytes", path.display())]
    Short { path: PathBuf },
    #[error("the line has no regions for its queues: {0}")]
    Misaligned(#[from] Misaligned),
    #[error("the line's queues cannot be: {0}")]
    Geometry(#[from] GeometryError),
    #[error("the line {} is none of this version: {source}", path.display())]
    Open { path: PathBuf, source: OpenError },
}

/// One end, with both queues.
pub struct Line {
    out: QueuingSource<OwnPages<'static>, PeerPages<'static>>,
    incoming: QueuingDestination<PeerPages<'static>, OwnPages<'static>>,
    buffer: Vec<u8>,
}

impl Line {
    /// Makes the file of a new line, which only its owner may open.
    ///
    /// # Errors
    /// See [`LineError`].
    pub fn make(path: &Path) -> Result<(), LineError> {
        let failed = |source| LineError::File { what: "make", path: path.to_owned(), source };
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true).mode(0o600);
        let file = options.open(path).map_err(failed)?;
        file.set_len(BYTES as u64).map_err(failed)?;
        let (geometry, memory) = (geometry()?, Memory::map(path, file)?);
        for side in [Side::Outside, Side::Inside] {
            let wrong = |source| LineError::Open { path: path.to_owned(), source };
            let Regions { messages, acknowledgement } = Regions::of(side);
            geometry.format_source(&mut memory.own(messages)?).map_err(wrong)?;
            geometry.format_destination(&mut memory.own(acknowledgement)?).map_err(wrong)?;
        }
        Ok(())
    }

    /// Opens an end of it. What the other end has sent before is not received.
    ///
    /// # Errors
    /// See [`LineError`].
    pub fn open(path: &Path, side: Side) -> Result<Self, LineError> {
        let failed = |source| LineError::File { what: "open", path: path.to_owned(), source };
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(failed)?;
        let (geometry, memory) = (geometry()?, Memory::map(path, file)?);
        let wrong = |source| LineError::Open { path: path.to_owned(), source };
        let (own, peer) = match side {
            Side::Outside => (Regions::of(side), Regions::of(Side::Inside)),
            Side::Inside => (Regions::of(side), Regions::of(Side::Outside)),
        };
        let out = QueuingSource::open(
            memory.own(own.messages)?,
            memory.peer(peer.acknowledgement)?,
            &geometry,
        );
        let incoming = QueuingDestination::open(
            memory.peer(peer.messages)?,
            memory.own(own.acknowledgement)?,
            &geometry,
        );
        Ok(Self {
            out: out.map_err(wrong)?,
            incoming: incoming.map_err(wrong)?,
            buffer: vec![0; MESSAGE_MAX],
        })
    }

    /// Whether a frame can be sent now.
    pub fn has_room(&mut self) -> bool {
        let status = self.out.status();
        status.waiting < status.depth
    }

    /// Whether the other end has taken all that was sent.
    pub fn is_taken(&mut self) -> bool {
        self.out.status().waiting == 0
    }

    /// Sends a frame; false if there is no room.
    pub fn send(&mut self, frame: Frame<'_>) -> bool {
        frame.message().is_some_and(|message| self.out.send(&message, Tsc(0)).is_ok())
    }

    /// The next frame. `None` if none waits, or what waits is no frame.
    pub fn receive(&mut self) -> Option<Frame<'_>> {
        let received = self.incoming.receive(&mut self.buffer).ok()?;
        Frame::parse(received.bytes)
    }
}

fn geometry() -> Result<Geometry, GeometryError> {
    Geometry::queuing(MESSAGE_MAX as u32, DEPTH, Policy::Refuse)
}

/// Where an end's own regions begin: that with its frames, and that with what it has received.
struct Regions {
    messages: usize,
    acknowledgement: usize,
}

impl Regions {
    fn of(side: Side) -> Self {
        match side {
            Side::Outside => Self { messages: 2 * PAGE, acknowledgement: 0 },
            Side::Inside => Self { messages: BYTES / 2, acknowledgement: PAGE },
        }
    }

    /// Bytes from a region's beginning to the next one's.
    fn bytes(start: usize) -> usize {
        match start {
            0 | PAGE => PAGE,
            _ if start < BYTES / 2 => BYTES / 2 - start,
            _ => BYTES - start,
        }
    }
}

/// The memory, mapped until the process ends.
struct Memory(NonNull<u8>);

impl Memory {
    fn map(path: &Path, file: File) -> Result<Self, LineError> {
        let failed = |source| LineError::Map { path: path.to_owned(), source };
        // What lies behind the end of a file can be mapped, and ends the process when it is touched.
        if file.metadata().is_ok_and(|file| file.len() < BYTES as u64) {
            return Err(LineError::Short { path: path.to_owned() });
        }
        let access = libc::PROT_READ | libc::PROT_WRITE;
        let file = Some(FileOffset::new(file, 0));
        let region = MmapRegion::<()>::build(file, BYTES, access, libc::MAP_SHARED);
        // An end lives as long as its process.
        let region: &'static MmapRegion = Box::leak(Box::new(region.map_err(failed)?));
        NonNull::new(region.as_ptr())
            .map(Self)
            .ok_or_else(|| failed(MmapRegionError::InvalidPointer))
    }

    fn own(&self, start: usize) -> Result<OwnPages<'static>, Misaligned> {
        // SAFETY: mapped for reading and writing until the process ends; `Regions` lie within it; and this type gives
        // the memory away as atomics only.
        unsafe { OwnPages::new(self.0.add(start), Regions::bytes(start)) }
    }

    fn peer(&self, start: usize) -> Result<PeerPages<'static>, Misaligned> {
        // SAFETY: as in `own`.
        unsafe { PeerPages::new(self.0.add(start), Regions::bytes(start)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_hold_their_queues_and_do_not_overlap() {
        let geometry = geometry().unwrap();
        let mut end = 0;
        for start in [0, PAGE, 2 * PAGE, BYTES / 2] {
            assert!(start >= end);
            end = start + Regions::bytes(start);
            assert!(end <= BYTES);
        }
        for side in [Side::Outside, Side::Inside] {
            let Regions { messages, acknowledgement } = Regions::of(side);
            assert!(geometry.source_bytes() <= Regions::bytes(messages));
            assert!(geometry.destination_bytes() <= Regions::bytes(acknowledgement));
        }
    }
}
