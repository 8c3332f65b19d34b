//! Port channels between two ends in one process.

#![allow(unsafe_code)]

use std::io;
use std::ptr::NonNull;
use std::sync::atomic::AtomicU64;
use std::thread;

use takt_channel::{
    Geometry, OwnPages, PeerPages, Policy, QueuingDestination, QueuingSource, ReadError,
    ReceiveError, SamplingDestination, SamplingSource, Ticks, Tsc,
};
use takt_tests::record::number;

use crate::{BYTES, Ends, Receiving, Sending};

/// Messages that can wait: as many as in the tests of whole systems.
const DEPTH: u32 = 4;

struct Queue(QueuingSource<OwnPages<'static>, PeerPages<'static>>);
struct QueueEnd(QueuingDestination<PeerPages<'static>, OwnPages<'static>>);
struct Variable(SamplingSource<OwnPages<'static>>);
struct VariableEnd {
    end: SamplingDestination<PeerPages<'static>>,
    last: Option<u64>,
}

/// A queue.
pub fn queuing() -> io::Result<Ends> {
    let geometry =
        Geometry::queuing(BYTES as u32, DEPTH, Policy::Refuse).map_err(io::Error::other)?;
    let (mut messages, for_reader) = region(geometry.source_bytes())?;
    let (mut taken, for_writer) = region(geometry.destination_bytes())?;
    geometry.format_source(&mut messages).map_err(io::Error::other)?;
    geometry.format_destination(&mut taken).map_err(io::Error::other)?;
    let source = QueuingSource::open(messages, for_writer, &geometry).map_err(io::Error::other)?;
    let end = QueuingDestination::open(for_reader, taken, &geometry).map_err(io::Error::other)?;
    Ok((Box::new(Queue(source)), Box::new(QueueEnd(end))))
}

/// A variable.
pub fn sampling() -> io::Result<Ends> {
    let geometry = Geometry::sampling(BYTES as u32).map_err(io::Error::other)?;
    let (mut messages, for_reader) = region(geometry.source_bytes())?;
    geometry.format_source(&mut messages).map_err(io::Error::other)?;
    let source = SamplingSource::open(messages, &geometry).map_err(io::Error::other)?;
    let end = SamplingDestination::open(for_reader, &geometry, Ticks(u64::MAX));
    let end = end.map_err(io::Error::other)?;
    Ok((Box::new(Variable(source)), Box::new(VariableEnd { end, last: None })))
}

/// Memory to the end of the process, for its writer and for its reader.
fn region(bytes: usize) -> io::Result<(OwnPages<'static>, PeerPages<'static>)> {
    let words = (0..bytes.div_ceil(8)).map(|_| AtomicU64::new(0)).collect::<Vec<_>>().leak();
    let (start, bytes) = (NonNull::from_ref(words).cast(), size_of_val(words));
    // SAFETY: leaked, so mapped for ever, and made of atomics, which have no other owner.
    let own = unsafe { OwnPages::new(start, bytes) };
    // SAFETY: as above.
    let peer = unsafe { PeerPages::new(start, bytes) };
    Ok((own.map_err(io::Error::other)?, peer.map_err(io::Error::other)?))
}

impl Sending for Queue {
    fn send(&mut self, message: &[u8; BYTES]) -> io::Result<()> {
        self.0.send(message, Tsc(0)).map_err(io::Error::other)
    }
}

impl Receiving for QueueEnd {
    fn receive(&mut self, message: &mut [u8; BYTES]) -> io::Result<()> {
        loop {
            match self.0.receive(message) {
                Ok(_) => return Ok(()),
                Err(ReceiveError::Empty) => thread::yield_now(),
                Err(error) => return Err(io::Error::other(error)),
            }
        }
    }
}

impl Sending for Variable {
    fn send(&mut self, message: &[u8; BYTES]) -> io::Result<()> {
        self.0.write(message, Tsc(0)).map_err(io::Error::other)
    }
}

impl Receiving for VariableEnd {
    fn receive(&mut self, message: &mut [u8; BYTES]) -> io::Result<()> {
        loop {
            match self.end.read(message, Tsc(0)) {
                Ok(sample) if number(sample.bytes) != self.last => {
                    self.last = number(sample.bytes);
                    return Ok(());
                }
                Ok(_) | Err(ReadError::NeverWritten) => thread::yield_now(),
                Err(error) => return Err(io::Error::other(error)),
            }
        }
    }
}
