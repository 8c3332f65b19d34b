//! Events, as the trace-event format has them, one after the other in an array.

use std::io::{self, ErrorKind, Write};

use serde::Serialize;

/// The last instant that three decimals of a double still tell from its neighbours: 52 days.
pub const LATEST_NS: u64 = 1 << 52;

/// A line of the viewer.
#[derive(Clone, Copy)]
pub struct Track {
    /// Its process.
    pub process: u64,
    /// Its thread; no other process has one of that number.
    pub thread: u64,
    /// Up to where it is drawn, in nanoseconds of the trace.
    pub drawn_to: u64,
}

/// An event of the format; the names of its fields are the format's.
#[derive(Serialize)]
struct Event<'a, A> {
    name: &'a str,
    ph: Phase,
    ts: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<f64>,
    pid: u64,
    tid: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    args: Option<A>,
}

/// What an event is.
#[derive(Clone, Copy, Serialize)]
pub enum Phase {
    #[serde(rename = "M")]
    Metadata,
    #[serde(rename = "X")]
    Slice,
    #[serde(rename = "B")]
    Begin,
    #[serde(rename = "E")]
    End,
    /// Of its thread, which is the format's default scope.
    #[serde(rename = "i")]
    Mark,
}

/// No `args`.
pub const NOTHING: Option<()> = None;

/// The `args` of an event that names a process or a thread.
#[derive(Serialize)]
pub struct Name<'a> {
    pub name: &'a str,
}

/// The array, while it is being written.
pub struct Events<W: Write> {
    out: W,
    /// Those that were added since the last [`commit`](Self::commit).
    batch: Vec<u8>,
    batched: u64,
    /// Whether the array has begun.
    begun: bool,
    /// Events for which there was no room.
    dropped: u64,
    /// Those of them that the reader of the trace does not know of.
    untold: u64,
    /// Those of which this batch tells.
    telling: u64,
    failed: Option<io::Error>,
}

impl<W: Write> Events<W> {
    pub fn new(out: W) -> Self {
        Self {
            out,
            batch: Vec::new(),
            batched: 0,
            begun: false,
            dropped: 0,
            untold: 0,
            telling: 0,
            failed: None,
        }
    }

    /// Adds an event at an instant, with a length if it is a slice; both in nanoseconds. After an
    /// error, nothing is added any more.
    pub fn add(
        &mut self,
        track: Track,
        ph: Phase,
        name: &str,
        at: u64,
        length: Option<u64>,
        args: Option<impl Serialize>,
    ) {
        if self.failed.is_some() {
            return;
        }
        let Track { process: pid, thread: tid, .. } = track;
        let event = Event { name, ph, ts: micros(at), dur: length.map(micros), pid, tid, args };
        let separator = if self.begun || self.batched > 0 { ",\n" } else { "[\n" };
        self.batch.extend_from_slice(separator.as_bytes());
        self.failed = serde_json::to_writer(&mut self.batch, &event).err().map(io::Error::from);
        self.batched += 1;
    }

    /// Writes what was added since the last time, in one piece. Where there is no room (`WouldBlock`) all of
    /// it is dropped and counted.
    pub fn commit(&mut self) {
        if self.failed.is_none() {
            match self.out.write_all(&self.batch) {
                Ok(()) => self.begun |= self.batched > 0,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    // The telling itself is no loss.
                    let lost = self.batched - u64::from(self.telling > 0);
                    self.dropped += lost;
                    self.untold += self.telling + lost;
                }
                Err(error) => self.failed = Some(error),
            }
        }
        self.batch.clear();
        (self.batched, self.telling) = (0, 0);
    }

    /// Events for which there was no room.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Those that the reader of the trace does not know of. If there are any, the next event has to tell
    /// of them.
    pub fn take_untold(&mut self) -> u64 {
        self.telling = std::mem::take(&mut self.untold);
        self.telling
    }

    /// Ends the array, or tells the first error.
    pub fn finish(mut self) -> io::Result<()> {
        self.commit();
        match self.failed {
            Some(error) => Err(error),
            None => self.out.write_all(b"\n]\n").and_then(|()| self.out.flush()),
        }
    }
}

/// Exact in its three decimals for all up to [`LATEST_NS`].
pub fn micros(ns: u64) -> f64 {
    ns as f64 / 1e3
}
