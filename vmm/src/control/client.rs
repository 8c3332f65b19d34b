//! One connection, with its two bounded buffers.
//!
//! As long as a client has not taken what it asked for, nothing more is read from it: what it sends
//! then piles up in its own kernel buffer. Only events and windows come unasked, and they pile up to
//! [`BACKLOG_MAX`] at most.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;

use takt_scheduler::time::Nanos;

use super::door::Rights;
use super::protocol::{self, Answer, ConsoleOutput, LINE_MAX, Refusal, TracedWindow, Values, hex};
use super::tracing::Tracing;

/// Bytes of events that a client may be behind with.
const BACKLOG_MAX: usize = 64 * 1024;
/// Bytes with which a client may be behind and still be told of one window more. Less than that of
/// events, so that who traces slowly misses windows and is not let go of for an event.
const TRACE_BACKLOG_MAX: usize = 32 * 1024;
/// Turns in a row in which a client may take nothing of what waits for it: 10 s of ticks.
pub(super) const PATIENCE: u32 = 500;

/// A client.
pub(super) struct Client {
    stream: UnixStream,
    /// What came and is no whole line yet, or was not read yet.
    input: Vec<u8>,
    /// What was not sent yet.
    output: Vec<u8>,
    /// True if it gets every event.
    pub follows: bool,
    /// By this it is known elsewhere.
    pub id: u64,
    /// What it may do.
    pub rights: Rights,
    /// A program has entered another version since the client asked for the status.
    pub places_have_changed: bool,
    /// The order of values of whose result it is still to be told.
    pub waits_for: Option<u64>,
    /// Lines of values that it was not told since the last one.
    missed: u64,
    /// Whose console it gets.
    pub attached: Option<usize>,
    /// Bytes of that console that it was not told since the last ones.
    unread: u64,
    /// What it gets of the windows, if it has asked for them.
    pub trace: Option<Tracing>,
    /// Nothing more is read; when all is sent, it goes.
    closing: bool,
    /// Turns without progress.
    stalled: u32,
}

/// What came from a client.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Came {
    /// A line, without its newline.
    Line(Vec<u8>),
    /// The start of a line that is too long.
    TooLong,
    /// Nothing at present.
    Nothing,
}

impl Client {
    pub fn new(stream: UnixStream, id: u64, rights: Rights) -> Client {
        Client {
            stream,
            id,
            rights,
            places_have_changed: false,
            waits_for: None,
            missed: 0,
            attached: None,
            unread: 0,
            input: Vec::new(),
            output: Vec::new(),
            follows: false,
            trace: None,
            closing: false,
            stalled: 0,
        }
    }

    /// Sends what waits; false if the client is gone, or is to go.
    pub fn flush(&mut self) -> bool {
        let Some(sent) = self.push() else { return false };
        self.stalled = if sent > 0 || self.output.is_empty() { 0 } else { self.stalled + 1 };
        let done = self.output.is_empty() && self.trace.is_none();
        self.stalled <= PATIENCE && !(self.closing && done)
    }

    /// Sends what the socket takes; returns how much, or `None` if the client is gone.
    fn push(&mut self) -> Option<usize> {
        let mut sent = 0;
        while let Some(rest) = self.output.get(sent..).filter(|rest| !rest.is_empty()) {
            match self.stream.write(rest) {
                Ok(count) if count > 0 => sent += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                _ => return None,
            }
        }
        self.output.drain(..sent);
        Some(sent)
    }

    /// True if it may ask for something.
    pub fn may_ask(&self) -> bool {
        self.output.is_empty() && !self.closing && self.waits_for.is_none()
    }

    /// Whether the places in programs that it names can be those of the versions that run.
    pub fn knows_places(&self) -> Result<(), Refusal> {
        if self.places_have_changed {
            let text = "a program runs another version since you asked for the status: ask for it, and look up the places anew";
            return Err(Refusal::new(protocol::ErrorKind::Refused, text));
        }
        Ok(())
    }

    /// Takes the next line.
    pub fn receive(&mut self) -> Came {
        loop {
            let end = self.input.iter().take(LINE_MAX).position(|byte| *byte == b'\n');
            if let Some(end) = end {
                let rest = self.input.split_off(end + 1);
                let mut line = std::mem::replace(&mut self.input, rest);
                line.pop();
                return Came::Line(line);
            }
            if self.input.len() >= LINE_MAX {
                self.input = Vec::new();
                return Came::TooLong;
            }
            let mut buffer = [0; 4096];
            match self.stream.read(&mut buffer) {
                Ok(0) => {
                    self.close();
                    return Came::Nothing;
                }
                Ok(count) => self.input.extend_from_slice(buffer.get(..count).unwrap_or_default()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    if error.kind() != ErrorKind::WouldBlock {
                        self.close();
                    }
                    return Came::Nothing;
                }
            }
        }
    }

    /// Sends a line as soon as there is room.
    pub fn answer(&mut self, line: &[u8]) {
        self.output.extend_from_slice(line);
    }

    /// Sends an event; false if the client is too far behind.
    pub fn tell(&mut self, line: &[u8]) -> bool {
        let fits = self.output.len() + line.len() <= BACKLOG_MAX;
        if fits {
            self.output.extend_from_slice(line);
        }
        fits
    }

    /// Sends a window, if the client traces and there is room for it. It is not made otherwise.
    pub fn trace_window(&mut self, window: impl FnOnce() -> TracedWindow) {
        if self.output.len() >= TRACE_BACKLOG_MAX {
            // There can be many windows in one turn. A client that is gone is dropped at the next.
            if self.push().is_some_and(|sent| sent > 0) {
                self.stalled = 0;
            }
        }
        let Some(trace) = &mut self.trace else { return };
        if self.output.len() < TRACE_BACKLOG_MAX {
            let line = trace.tell(window()).line();
            self.output.extend_from_slice(&line);
        } else {
            trace.drop_one();
        }
    }

    /// Sends values, if there is room for them; else they are counted. `missed` came before them and is gone already.
    pub fn tell_values(&mut self, missed: u64, values: impl FnOnce(u64) -> Values) {
        if self.output.len() >= TRACE_BACKLOG_MAX && self.push().is_some_and(|sent| sent > 0) {
            self.stalled = 0;
        }
        self.missed = self.missed.saturating_add(missed);
        if self.output.len() < TRACE_BACKLOG_MAX {
            let missed = std::mem::take(&mut self.missed);
            let line = Answer::Values { values: values(missed) }.line();
            self.output.extend_from_slice(&line);
        } else {
            self.missed = self.missed.saturating_add(1);
        }
    }

    /// From now on it gets this console.
    pub fn attach(&mut self, place: usize) {
        (self.attached, self.unread) = (Some(place), 0);
    }

    /// Sends what came of its console, if there is room for it; else it is counted.
    pub fn tell_console(&mut self, partition: &str, bytes: &[u8]) {
        if self.output.len() >= TRACE_BACKLOG_MAX {
            self.unread = self.unread.saturating_add(bytes.len() as u64);
            return;
        }
        let missed = std::mem::take(&mut self.unread);
        let (partition, bytes) = (partition.to_owned(), hex(bytes));
        let console = ConsoleOutput { partition, missed, bytes };
        self.output.extend_from_slice(&Answer::Console { console }.line());
    }

    /// Ends the trace if its time has come.
    pub fn end_trace(&mut self, now: Nanos) {
        if let Some(end) = self.trace.as_ref().and_then(|trace| trace.end(now)) {
            self.trace = None;
            self.answer(&end.line());
        }
    }

    /// Lets it go when all is sent.
    pub fn close(&mut self) {
        self.closing = true;
    }
}
