//! The way of a guest's console output to the terminal.
//!
//! A vCPU thread must not write to a terminal: it could block, and the PLC's must not even make
//! the call. Bytes go through a ring that was allocated at start-up; the supervisor thread takes them
//! out. When the ring is full the kinds of guest differ. One with windows drops and counts, because
//! nothing may hold it up, nor wake it while others have windows. A Linux in the background waits, because
//! it can, and loses nothing as long as somebody reads.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};

/// Bytes that a ring holds: the supervisor thread empties it many times a second.
const CAPACITY: usize = 16 * 1024;

/// Where a serial port's output goes.
pub trait ConsoleOutput: io::Write {
    /// Whether a write of this many bytes would wait now.
    fn would_wait(&self, _bytes: usize) -> bool {
        false
    }

    /// Another guest prints from here on. What watches lines forgets what it has of one.
    fn begin_anew(&mut self) {}
}

impl<W: ConsoleOutput + ?Sized> ConsoleOutput for Box<W> {
    fn would_wait(&self, bytes: usize) -> bool {
        W::would_wait(self, bytes)
    }

    fn begin_anew(&mut self) {
        W::begin_anew(self);
    }
}

impl ConsoleOutput for Vec<u8> {}
impl ConsoleOutput for DroppingOutput {}

impl ConsoleOutput for WaitingOutput {
    fn would_wait(&self, bytes: usize) -> bool {
        self.producer.slots() < bytes.min(CAPACITY) && !self.gives_up()
    }
}

/// Makes the two ends of a console's output that drops what does not fit.
#[must_use]
pub fn dropping() -> (DroppingOutput, OutputEnd) {
    let (producer, consumer) = RingBuffer::new(CAPACITY);
    let dropped = Arc::new(AtomicU64::new(0));
    let end = OutputEnd { consumer, dropped: dropped.clone(), waits: false };
    (DroppingOutput { producer, dropped }, end)
}

/// Makes the two ends of a console's output that waits for room, until `stop` is set.
#[must_use]
pub fn waiting(stop: Arc<AtomicBool>) -> (WaitingOutput, OutputEnd) {
    let (producer, consumer) = RingBuffer::new(CAPACITY);
    let end = OutputEnd { consumer, dropped: Arc::default(), waits: true };
    (WaitingOutput { producer, stop }, end)
}

/// The guest's end, for a guest that nothing may hold up.
pub struct DroppingOutput {
    producer: Producer<u8>,
    dropped: Arc<AtomicU64>,
}

impl DroppingOutput {
    /// Takes as much of `bytes` as there is room for, in time proportional to their number.
    pub fn write(&mut self, bytes: &[u8]) {
        let (_, rest) = self.producer.push_partial_slice(bytes);
        if !rest.is_empty() {
            self.dropped.fetch_add(rest.len() as u64, Ordering::Relaxed);
        }
    }
}

/// Never fails.
impl io::Write for DroppingOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        DroppingOutput::write(self, bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The guest's end, for a guest that may be held up.
pub struct WaitingOutput {
    producer: Producer<u8>,
    stop: Arc<AtomicBool>,
}

impl WaitingOutput {
    fn gives_up(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.producer.is_abandoned()
    }
}

impl io::Write for WaitingOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (taken, _) = self.producer.push_partial_slice(bytes);
        if !taken.is_empty() || bytes.is_empty() {
            return Ok(taken.len());
        }
        let gone = self.gives_up();
        Err(if gone { io::ErrorKind::BrokenPipe } else { io::ErrorKind::WouldBlock }.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// How much may be taken out of a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// Bytes.
    pub bytes: usize,
    /// Ends of lines.
    pub lines: usize,
}

impl Allowance {
    /// As much as there is.
    pub const ALL: Self = Self { bytes: usize::MAX, lines: usize::MAX };

    /// How many of these bytes it allows.
    #[must_use]
    pub fn of(&self, bytes: &[u8]) -> usize {
        let ends = bytes.iter().take(self.bytes).enumerate().filter(|(_, byte)| **byte == b'\n');
        let most = bytes.len().min(self.bytes);
        match self.lines.checked_sub(1) {
            None => 0,
            Some(last) => ends.map(|(at, _)| at + 1).nth(last).unwrap_or(most),
        }
    }
}

/// The terminal's end.
pub struct OutputEnd {
    consumer: Consumer<u8>,
    dropped: Arc<AtomicU64>,
    waits: bool,
}

impl OutputEnd {
    /// Appends all that is waiting to `buffer`.
    pub fn drain_into(&mut self, buffer: &mut Vec<u8>) {
        self.take_into(buffer, Allowance::ALL);
    }

    /// Appends to `buffer` what is waiting, as far as that is allowed.
    pub fn take_into(&mut self, buffer: &mut Vec<u8>, most: Allowance) {
        let before = buffer.len();
        if let Ok(chunk) = self.consumer.read_chunk(self.consumer.slots()) {
            let (first, second) = chunk.as_slices();
            buffer.extend_from_slice(first);
            buffer.extend_from_slice(second);
            let taken = buffer.get(before..).map_or(0, |new| most.of(new));
            buffer.truncate(before + taken);
            chunk.commit(taken);
        }
    }

    /// Whether the guest waits for room, so that what is left in the ring is not lost.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.waits
    }

    /// Bytes that were dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
#[path = "output_tests.rs"]
mod tests;
