//! One carried connection, as either end sees it.
//!
//! Each end sends only as much as the other has room for, so that a client that does not read holds up
//! no other: its bytes wait in Takt, which then counts what the client misses, or lets it go.

use std::io::{self, ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use crate::frame::{Frame, PAYLOAD_MAX};
use crate::line::Line;

/// Bytes of a connection that an end keeps until its stream takes them.
pub const WINDOW: usize = 64 * 1024;
/// So long a stream may take nothing of what waits for it. Takt's own patience is the same.
const PATIENCE: Duration = Duration::from_secs(10);
/// Frames of one connection in a turn, so that each gets its part.
const FRAMES_MAX: usize = 16;

/// How a connection ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// Both directions have ended, and both ends know.
    Done,
    /// The other end is to be told.
    Broken,
}

/// A connection.
pub(crate) struct Connection {
    pub id: u32,
    stream: UnixStream,
    /// The other end knows of it.
    announced: bool,
    /// Bytes for which the other end has room.
    room: usize,
    /// Bytes that the stream has taken, and of which the other end does not know yet.
    taken: usize,
    /// What came from the other end and the stream has not taken yet.
    pending: Vec<u8>,
    /// No more comes from the other end; the stream knows.
    ended_there: bool,
    shut: bool,
    /// No more comes from the stream; the other end knows.
    ended_here: bool,
    told: bool,
    /// When the stream took something last, if something waits for it.
    waits_since: Option<Instant>,
}

impl Connection {
    /// A stream with this number. The end that was not asked for it has to announce it.
    pub fn new(id: u32, stream: UnixStream, announced: bool) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        Ok(Self {
            id,
            stream,
            announced,
            room: WINDOW,
            taken: 0,
            pending: Vec::new(),
            ended_there: false,
            shut: false,
            ended_here: false,
            told: false,
            waits_since: None,
        })
    }

    /// Takes bytes from the other end.
    pub fn take(&mut self, bytes: &[u8]) -> Result<(), Over> {
        // An honest end sends no more than there is room for, and nothing after its end.
        if self.ended_there || self.pending.len() + bytes.len() > WINDOW {
            return Err(Over::Broken);
        }
        self.pending.extend_from_slice(bytes);
        Ok(())
    }

    /// The other end has room for more. It never has more than the window, whatever it says.
    pub fn grant(&mut self, bytes: u32) {
        self.room = self.room.saturating_add(bytes as usize).min(WINDOW);
    }

    /// No more comes from the other end.
    pub fn end(&mut self) {
        self.ended_there = true;
    }

    /// The connection is over at the other end. What came before is still for the stream.
    pub fn gone(&mut self) {
        self.ended_there = true;
        self.ended_here = true;
        self.told = true;
    }

    /// Moves what can be moved now, within bounds.
    pub fn serve(&mut self, line: &mut Line, now: Instant) -> Result<(), Over> {
        if !self.announced {
            self.announced = line.send(Frame::Open(self.id));
            if !self.announced {
                return Ok(());
            }
        }
        self.write(now)?;
        if self.ended_there && self.pending.is_empty() && !self.shut {
            // A stream that is closed already needs no telling.
            let _ = self.stream.shutdown(Shutdown::Write);
            self.shut = true;
        }
        let worth_telling = self.taken >= WINDOW / 4 || self.pending.is_empty();
        if self.taken > 0 && worth_telling && line.send(Frame::Room(self.id, self.taken as u32)) {
            self.taken = 0;
        }
        self.read(line)?;
        if self.ended_here && !self.told {
            self.told = line.send(Frame::End(self.id));
        }
        if self.shut && self.told { Err(Over::Done) } else { Ok(()) }
    }

    /// Writes what waits for the stream.
    fn write(&mut self, now: Instant) -> Result<(), Over> {
        let mut written = 0;
        while let Some(rest) = self.pending.get(written..).filter(|rest| !rest.is_empty()) {
            match self.stream.write(rest) {
                Ok(count) if count > 0 => written += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                _ => return Err(Over::Broken),
            }
        }
        self.pending.drain(..written);
        self.taken += written;
        if self.pending.is_empty() {
            self.waits_since = None;
            return Ok(());
        }
        let since = *self.waits_since.get_or_insert(now);
        if written > 0 {
            self.waits_since = Some(now);
        } else if now.saturating_duration_since(since) > PATIENCE {
            return Err(Over::Broken);
        }
        Ok(())
    }

    /// Sends what the stream has, as far as the other end and the line have room.
    fn read(&mut self, line: &mut Line) -> Result<(), Over> {
        let mut buffer = [0; PAYLOAD_MAX];
        for _ in 0..FRAMES_MAX {
            if self.ended_here || self.room == 0 || !line.has_room() {
                break;
            }
            let most = buffer.len().min(self.room);
            let Some(target) = buffer.get_mut(..most) else { break };
            match self.stream.read(target) {
                Ok(0) => self.ended_here = true,
                Ok(count) => {
                    let data = target.get(..count).unwrap_or_default();
                    if !line.send(Frame::Data(self.id, data)) {
                        return Err(Over::Broken);
                    }
                    self.room = self.room.saturating_sub(count);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => return Err(Over::Broken),
            }
        }
        Ok(())
    }

    /// Bytes that are kept for the stream.
    #[cfg(test)]
    pub fn kept(&self) -> usize {
        self.pending.len()
    }
}
