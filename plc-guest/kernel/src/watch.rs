//! Which bytes of programs are watched, and how far a sample of them has got.
//!
//! A sample is taken piece by piece, in steps of a bounded length, after the work of a window. All its pieces must be
//! of the same moment: a job that runs in between, or a window that ends, gives the sample up, which is counted.

use takt_abi::live::{Range, Refusal, SAMPLE_BYTES, WATCHED_RANGES};

use crate::time::{Instant, Span};

/// Some ranges.
#[derive(Clone, Debug)]
struct List {
    ranges: [Option<Range>; WATCHED_RANGES],
    count: usize,
    bytes: usize,
}

impl List {
    const EMPTY: Self = Self { ranges: [None; WATCHED_RANGES], count: 0, bytes: 0 };
}

/// A sample that is being taken.
#[derive(Clone, Copy, Debug)]
struct Cursor {
    /// Release of the window.
    release: u64,
    range: usize,
    /// Bytes of that range that have been taken.
    taken: u16,
}

/// All that is watched.
#[derive(Clone, Debug)]
pub struct Watch {
    /// What is being told.
    next: List,
    current: List,
    serial: u32,
    interval: Span,
    /// When the next sample is due.
    due: Instant,
    /// The window of the last sample, or of one for which there was no room.
    last: Option<u64>,
    cursor: Option<Cursor>,
    missed: u32,
}

impl Watch {
    /// Nothing is watched.
    pub const NOTHING: Self = Self {
        next: List::EMPTY,
        current: List::EMPTY,
        serial: 0,
        interval: Span::ZERO,
        due: Instant(0),
        last: None,
        cursor: None,
        missed: 0,
    };

    /// A new list is about to be told.
    pub fn clear(&mut self) {
        self.next.count = 0;
        self.next.bytes = 0;
    }

    /// One range more of it.
    ///
    /// # Errors
    /// [`Refusal::Full`].
    pub fn add(&mut self, range: Range) -> Result<(), Refusal> {
        let bytes = self.next.bytes + usize::from(range.bytes);
        let slot = self.next.ranges.get_mut(self.next.count);
        let slot = slot.filter(|_| bytes <= SAMPLE_BYTES).ok_or(Refusal::Full)?;
        *slot = Some(range);
        self.next.count += 1;
        self.next.bytes = bytes;
        Ok(())
    }

    /// The list is complete.
    pub fn begin(&mut self, serial: u32, interval: Span) {
        let count = if serial == 0 { 0 } else { self.next.count };
        self.current.ranges[..count].copy_from_slice(&self.next.ranges[..count]);
        self.current.count = count;
        self.current.bytes = self.next.bytes;
        self.serial = serial;
        self.interval = interval;
        self.due = Instant(0);
        self.last = None;
        self.cursor = None;
        self.missed = 0;
    }

    /// A program is about to change to another version, where the places do not hold. A list with one of them ends;
    /// Takt sends the rest of it anew.
    pub fn leave(&mut self, program: u8) {
        let has = |list: &List| {
            list.ranges[..list.count].iter().flatten().any(|range| range.program == program)
        };
        if has(&self.next) || has(&self.current) {
            self.clear();
            self.begin(0, Span::ZERO);
        }
    }

    /// The number of the list.
    #[must_use]
    pub const fn serial(&self) -> u32 {
        self.serial
    }

    /// Samples that were given up since the last whole one.
    #[must_use]
    pub const fn missed(&self) -> u32 {
        self.missed
    }

    /// True if a sample is under way in this window, or one is due, which then begins.
    pub fn is_due(&mut self, release: u64, now: Instant) -> bool {
        match self.cursor {
            Some(cursor) if cursor.release == release => return true,
            Some(_) => self.give_up(),
            None => {}
        }
        let due = self.current.count > 0 && self.last != Some(release) && now >= self.due;
        if due {
            self.cursor = Some(Cursor { release, range: 0, taken: 0 });
        }
        due
    }

    /// The next piece of the sample, of at most so many bytes; none if there is none, or no room.
    pub fn piece(&mut self, room: u16) -> Option<Range> {
        let cursor = self.cursor.as_mut()?;
        let ranges = self.current.ranges.get(..self.current.count)?;
        let range = (*ranges.get(cursor.range)?)?;
        let bytes = (range.bytes - cursor.taken).min(room);
        if bytes == 0 {
            return None;
        }
        let piece = Range { offset: range.offset + u32::from(cursor.taken), bytes, ..range };
        cursor.taken += bytes;
        if cursor.taken == range.bytes {
            (cursor.range, cursor.taken) = (cursor.range + 1, 0);
        }
        Some(piece)
    }

    /// True if no piece of the sample has been taken.
    #[must_use]
    pub fn is_at_start(&self) -> bool {
        self.cursor.is_some_and(|cursor| (cursor.range, cursor.taken) == (0, 0))
    }

    /// True if the last piece of the sample has been taken.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.cursor.is_some_and(|cursor| cursor.range == self.current.count)
    }

    /// The whole sample has been sent.
    pub fn sent(&mut self, now: Instant) {
        if let Some(cursor) = self.cursor.take() {
            self.last = Some(cursor.release);
            self.due = now.after(self.interval);
            self.missed = 0;
        }
    }

    /// A job runs: what of a sample is still to be taken would be of another moment.
    pub fn give_up(&mut self) {
        if self.cursor.is_some() {
            self.cursor = None;
            self.missed = self.missed.saturating_add(1);
        }
    }

    /// There is no room for the sample, and will not be in this window.
    pub fn give_up_for_now(&mut self) {
        self.last = self.cursor.map(|cursor| cursor.release);
        self.give_up();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::live::Area;

    fn range(offset: u32, bytes: u16) -> Range {
        Range { program: 0, area: Area::State, offset, bytes }
    }

    fn watching(ranges: &[Range], interval: u64) -> Watch {
        let mut watch = Watch::NOTHING;
        ranges.iter().for_each(|range| watch.add(*range).unwrap());
        watch.begin(1, Span(interval));
        watch
    }

    #[test]
    fn pieces_have_all_bytes_in_their_order() {
        let mut watch = watching(&[range(0, 4), range(100, 10), range(8, 1)], 0);
        assert!(watch.is_due(7, Instant(0)));
        let mut pieces = Vec::new();
        for room in [6, 3, 100, 100] {
            pieces.extend(watch.piece(room).map(|piece| (piece.offset, piece.bytes)));
        }
        assert_eq!(pieces, [(0, 4), (100, 3), (103, 7), (8, 1)]);
        assert!(watch.is_whole() && watch.piece(100).is_none());
        watch.sent(Instant(5));
        assert!(!watch.is_due(7, Instant(6)), "one in a window");
        assert!(watch.is_due(8, Instant(7)));
    }

    #[test]
    fn a_sample_is_of_one_moment_or_given_up() {
        let mut watch = watching(&[range(0, 4), range(8, 4)], 0);
        assert!(watch.is_due(7, Instant(0)));
        watch.piece(4).unwrap();
        watch.give_up();
        assert!(watch.is_due(7, Instant(0)), "again in this window");
        assert_eq!(watch.piece(100), Some(range(0, 4)), "from the beginning");
        assert!(watch.is_due(8, Instant(0)), "its window is over");
        assert_eq!((watch.piece(100), watch.missed()), (Some(range(0, 4)), 2));
        watch.give_up_for_now();
        assert!(!watch.is_due(8, Instant(0)));
        assert!(watch.is_due(9, Instant(0)));
        assert_eq!(watch.missed(), 3);
        while watch.piece(100).is_some() {}
        watch.sent(Instant(0));
        assert_eq!(watch.missed(), 0);
    }

    #[test]
    fn samples_come_not_sooner_than_was_asked_for() {
        let mut watch = watching(&[range(0, 4)], 100);
        let mut sent = Vec::new();
        for release in 0..10 {
            let now = Instant(release * 40);
            if watch.is_due(release, now) {
                watch.piece(100).unwrap();
                watch.sent(now);
                sent.push(release);
            }
        }
        assert_eq!(sent, [0, 3, 6, 9]);
        watch.begin(0, Span::ZERO);
        assert!(!watch.is_due(10, Instant(1_000)), "number 0 ends it");
    }

    #[test]
    fn a_list_with_a_program_that_changes_ends() {
        let mut watch = watching(&[range(0, 4), range(8, 4)], 0);
        watch.leave(1);
        assert!(watch.is_due(7, Instant(0)));
        watch.leave(0);
        assert!(watch.piece(100).is_none() && !watch.is_due(8, Instant(0)));
        // What was told of the next list is gone too.
        watch.add(range(0, 4)).unwrap();
        watch.leave(0);
        watch.begin(2, Span::ZERO);
        assert!(!watch.is_due(9, Instant(0)));
    }

    #[test]
    fn a_list_has_an_end() {
        let mut watch = Watch::NOTHING;
        for _ in 0..WATCHED_RANGES {
            watch.add(range(0, 1)).unwrap();
        }
        assert_eq!(watch.add(range(0, 1)), Err(Refusal::Full));
        watch.clear();
        watch.add(range(0, 40_000)).unwrap();
        assert_eq!(watch.add(range(0, 40_000)), Err(Refusal::Full));
    }
}
