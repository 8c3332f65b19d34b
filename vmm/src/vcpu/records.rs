//! The ring in which a thread with windows records them for the supervisor thread.
//!
//! The supervisor thread may be as late as it likes. The windows of a record that does not fit are counted, and the count is seen
//! at once: figures that lack a window must not look complete while the run lasts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};
use takt_record::Record;

/// Makes both ends of a ring with room for this many records.
#[must_use]
pub fn records(room: usize) -> (RecordWriter, RecordReader) {
    let (producer, consumer) = RingBuffer::new(room);
    let unrecorded = Arc::<AtomicU64>::default();
    (
        RecordWriter { ring: producer, unrecorded: unrecorded.clone() },
        RecordReader { ring: consumer, unrecorded },
    )
}

/// The end of the thread with windows.
pub struct RecordWriter {
    ring: Producer<Record>,
    unrecorded: Arc<AtomicU64>,
}

impl RecordWriter {
    /// Records it, or counts its windows if there is no room. Never waits.
    pub fn push(&mut self, record: Record) {
        let windows = match &record {
            Record::Window(_) => 1,
            Record::Skipped(skipped) => skipped.count,
            // The window that they are of has a record of its own.
            Record::Detour(_) | Record::Guard(_) => 0,
        };
        if self.ring.push(record).is_err() {
            self.unrecorded.fetch_add(windows, Ordering::Relaxed);
        }
    }
}

/// The supervisor thread's end.
pub struct RecordReader {
    ring: Consumer<Record>,
    unrecorded: Arc<AtomicU64>,
}

impl RecordReader {
    /// Takes the oldest record that is there.
    pub fn pop(&mut self) -> Option<Record> {
        self.ring.pop().ok()
    }

    /// Windows whose record did not fit since the epoch. The figures of their partition lack them.
    #[must_use]
    pub fn unrecorded(&self) -> u64 {
        self.unrecorded.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use takt_record::{Detour, Exit, Record, Skipped};
    use takt_scheduler::time::Tsc;

    use super::records;

    #[test]
    fn what_does_not_fit_is_counted_at_once() {
        let (mut writer, mut reader) = records(1);
        let record = |count| Record::Skipped(Skipped { count, due: Tsc(0), woken: Tsc(0) });
        (1..=3).for_each(|count| writer.push(record(count)));
        let detour = Detour { exit: Exit::Other, left: Tsc(0), entered: Tsc(0) };
        writer.push(Record::Detour(detour));
        // Two windows that did not happen, and three.
        assert_eq!(reader.unrecorded(), 5);
        assert_eq!((reader.pop(), reader.pop()), (Some(record(1)), None));
        writer.push(record(4));
        assert_eq!((reader.pop(), reader.unrecorded()), (Some(record(4)), 5));
    }
}
