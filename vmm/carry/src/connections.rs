//! All carried connections of an end.

use std::os::unix::net::UnixStream;
use std::time::Instant;

use crate::connection::{Connection, Over};
use crate::frame::Frame;
use crate::line::Line;

/// Most connections at a time. Takt serves fewer, and tells the others so.
pub const CONNECTIONS_MAX: usize = 24;
/// Frames that are received in one turn.
const FRAMES_MAX: usize = 64;
/// Connections that are opened in one turn: fewer than Takt accepts in one of its own, so that opening never waits.
const OPENED_MAX: usize = 16;

/// The connections of one end.
#[derive(Default)]
pub struct Connections {
    all: Vec<Connection>,
    /// Numbers of connections that ended here and of which the other end is still to be told.
    gone: Vec<u32>,
    /// The number of the next one that is added.
    next: u32,
}

impl Connections {
    /// None yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// True if none is left.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.all.is_empty() && self.gone.is_empty()
    }

    /// True if another one can be added.
    #[must_use]
    pub fn has_place(&self) -> bool {
        self.all.len() < CONNECTIONS_MAX
    }

    /// Adds a client's connection, of which the other end is told.
    pub fn add(&mut self, stream: UnixStream) {
        self.next = self.next.wrapping_add(1);
        let (id, place) = (self.next, self.has_place());
        let new = self.all.iter().all(|connection| connection.id != id);
        // A stream that cannot be set up is closed, and the client sees that.
        if let Some(connection) = Connection::new(id, stream, false).ok().filter(|_| place && new) {
            self.all.push(connection);
        }
    }

    /// Does what there is to do, within bounds. Tells whether the other end has said that it is ready.
    /// `open` connects to Takt; there is none outside.
    pub fn turn(
        &mut self,
        line: &mut Line,
        now: Instant,
        mut open: impl FnMut() -> Option<UnixStream>,
    ) -> bool {
        let (mut ready, mut opened) = (false, 0);
        for _ in 0..FRAMES_MAX {
            // What the other end is not told yet is bounded by taking nothing more from it.
            if !self.tell_gone(line) || opened == OPENED_MAX {
                break;
            }
            let Some(frame) = line.receive() else { break };
            match frame {
                Frame::Ready => ready = true,
                Frame::Open(id) => {
                    opened += 1;
                    self.open(id, &mut open);
                }
                Frame::Data(id, bytes) => self.with(id, |connection| connection.take(bytes)),
                Frame::Room(id, bytes) => self.with(id, |connection| {
                    connection.grant(bytes);
                    Ok(())
                }),
                Frame::End(id) => self.with(id, |connection| {
                    connection.end();
                    Ok(())
                }),
                Frame::Gone(id) => self.with(id, |connection| {
                    connection.gone();
                    Ok(())
                }),
            }
        }
        self.serve(line, now);
        self.tell_gone(line);
        ready
    }

    /// A connection that the other end has announced.
    fn open(&mut self, id: u32, open: &mut impl FnMut() -> Option<UnixStream>) {
        if self.all.iter().any(|connection| connection.id == id) {
            return;
        }
        let place = self.has_place();
        let stream = Some(()).filter(|()| place).and_then(|()| open());
        match stream.and_then(|stream| Connection::new(id, stream, true).ok()) {
            Some(connection) => self.all.push(connection),
            None => self.gone.push(id),
        }
    }

    /// Does something with a connection. A number that no connection has is one that has just ended, or a lie.
    fn with(&mut self, id: u32, what: impl FnOnce(&mut Connection) -> Result<(), Over>) {
        let Some(at) = self.all.iter().position(|connection| connection.id == id) else { return };
        if self.all.get_mut(at).is_some_and(|connection| what(connection).is_err()) {
            self.all.remove(at);
            self.gone.push(id);
        }
    }

    /// Serves each, and another one first each time.
    fn serve(&mut self, line: &mut Line, now: Instant) {
        if !self.all.is_empty() {
            self.all.rotate_left(1);
        }
        let gone = &mut self.gone;
        self.all.retain_mut(|connection| match connection.serve(line, now) {
            Ok(()) => true,
            Err(over) => {
                if over == Over::Broken {
                    gone.push(connection.id);
                }
                false
            }
        });
    }

    /// Tells the other end what has ended here; false if there is no room for all of it.
    fn tell_gone(&mut self, line: &mut Line) -> bool {
        self.gone.retain(|id| !line.send(Frame::Gone(*id)));
        self.gone.is_empty()
    }

    /// Bytes that are kept for streams.
    #[cfg(test)]
    pub(crate) fn kept(&self) -> usize {
        self.all.iter().map(Connection::kept).sum()
    }

    /// How many there are.
    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.all.len()
    }
}

#[cfg(test)]
#[path = "connections_tests.rs"]
mod tests;
