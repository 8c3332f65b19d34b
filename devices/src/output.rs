//! The way of a guest's console output to the terminal.
//!
//! A vCPU thread must not write to a terminal: it could block, and the PLC's must not even make
//! the call. Bytes go through a ring that was allocated at start-up; the event thread takes them
//! out. When the ring is full the two kinds of guest differ. A PLC drops and counts, because
//! nothing may hold it up. Linux waits, because it can, and loses nothing.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use rtrb::{Consumer, Producer, RingBuffer};

/// Bytes that a ring holds: the event thread empties it many times a second.
const CAPACITY: usize = 16 * 1024;
/// How long a waiting writer sleeps before it looks again.
const RETRY: Duration = Duration::from_millis(1);

/// Makes the two ends of a console's output that drops what does not fit.
#[must_use]
pub fn dropping() -> (DroppingOutput, OutputEnd) {
    let (producer, consumer) = RingBuffer::new(CAPACITY);
    let dropped = Arc::new(AtomicU64::new(0));
    let end = OutputEnd { consumer, dropped: dropped.clone() };
    (DroppingOutput { producer, dropped }, end)
}

/// Makes the two ends of a console's output that waits for room, until `stop` is set.
#[must_use]
pub fn waiting(stop: Arc<AtomicBool>) -> (WaitingOutput, OutputEnd) {
    let (producer, consumer) = RingBuffer::new(CAPACITY);
    let end = OutputEnd { consumer, dropped: Arc::default() };
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

/// The guest's end, for a guest that may be held up.
pub struct WaitingOutput {
    producer: Producer<u8>,
    stop: Arc<AtomicBool>,
}

impl io::Write for WaitingOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            let (taken, _) = self.producer.push_partial_slice(bytes);
            if !taken.is_empty() || bytes.is_empty() {
                return Ok(taken.len());
            }
            if self.stop.load(Ordering::Relaxed) || self.producer.is_abandoned() {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            thread::sleep(RETRY);
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The terminal's end.
pub struct OutputEnd {
    consumer: Consumer<u8>,
    dropped: Arc<AtomicU64>,
}

impl OutputEnd {
    /// Appends all that is waiting to `buffer`.
    pub fn drain_into(&mut self, buffer: &mut Vec<u8>) {
        if let Ok(chunk) = self.consumer.read_chunk(self.consumer.slots()) {
            let (first, second) = chunk.as_slices();
            buffer.extend_from_slice(first);
            buffer.extend_from_slice(second);
            chunk.commit_all();
        }
    }

    /// Bytes that were dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_flood_is_dropped_and_counted_to_the_byte() {
        let (mut guest, mut end) = dropping();
        let flood = vec![b'x'; CAPACITY];
        guest.write(&flood);
        guest.write(b"lost");
        let mut seen = Vec::new();
        end.drain_into(&mut seen);
        assert_eq!((seen, end.dropped()), (flood, 4));
        guest.write(b"back");
        let mut seen = Vec::new();
        end.drain_into(&mut seen);
        assert_eq!(seen, b"back");
    }

    #[test]
    fn a_waiting_writer_loses_nothing() {
        let stop = Arc::new(AtomicBool::new(false));
        let (mut guest, mut end) = waiting(stop);
        let sent: Vec<u8> = (0..3 * CAPACITY).map(|n| n as u8).collect();
        let copy = sent.clone();
        let writer = thread::spawn(move || guest.write_all(&copy).is_ok());
        let mut seen = Vec::new();
        while seen.len() < sent.len() {
            end.drain_into(&mut seen);
            thread::yield_now();
        }
        assert!(writer.join().unwrap());
        assert_eq!(seen, sent);
    }

    #[test]
    fn a_waiting_writer_gives_up_when_told_to_stop() {
        let stop = Arc::new(AtomicBool::new(true));
        let (mut guest, _end) = waiting(stop);
        assert!(guest.write_all(&vec![0; CAPACITY + 1]).is_err());
    }
}
