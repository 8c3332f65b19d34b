//! The end in the appliance, beside Takt.
//!
//! It has one connection of its own to Takt, on which it always has a `ping` under way. Takt answers in its turn, which
//! its supervisor thread places outside of all windows, and only that answer wakes this process. It does its own turn
//! then and asks again: some fifty times a second, whatever clients do.

use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::connections::Connections;
use crate::frame::Frame;
use crate::line::{Line, LineError, Side};

/// What is asked of Takt for each turn.
const PING: &[u8] = b"{\"version\":2,\"request\":\"ping\"}\n";
/// How often Takt's socket is looked for before there is one, which is before the run has begun.
const RETRY: Duration = Duration::from_millis(50);
/// Turns after Takt's end, for what it said last.
const LAST_TURNS: usize = 4;

/// Why nothing is carried any more.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum InsideError {
    #[error(transparent)]
    Line(#[from] LineError),
    #[error("cannot connect to Takt: {0}")]
    Connect(io::Error),
}

/// Carries connections between the line and Takt's control socket until Takt ends.
///
/// # Errors
/// See [`InsideError`].
pub fn run(line: &Path, socket: &Path) -> Result<(), InsideError> {
    let mut line = Line::open(line, Side::Inside)?;
    let mut pace = connect(socket)?;
    let mut connections = Connections::new();
    while wait_for_turn(&mut pace).is_ok() {
        // The other end may open the line later, and does not receive then what was sent before. So there is always
        // something for it to take; to be told again changes nothing.
        if line.is_taken() {
            line.send(Frame::Ready);
        }
        connections.turn(&mut line, Instant::now(), || UnixStream::connect(socket).ok());
    }
    for _ in 0..LAST_TURNS {
        connections.turn(&mut line, Instant::now(), || None);
    }
    Ok(())
}

fn connect(socket: &Path) -> Result<UnixStream, InsideError> {
    loop {
        match UnixStream::connect(socket) {
            Ok(stream) => return Ok(stream),
            Err(error)
                if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::ConnectionRefused) =>
            {
                thread::sleep(RETRY);
            }
            Err(error) => return Err(InsideError::Connect(error)),
        }
    }
}

/// Waits until Takt has had a turn.
fn wait_for_turn(pace: &mut UnixStream) -> io::Result<()> {
    pace.write_all(PING)?;
    let mut answer = [0; 512];
    loop {
        let count = pace.read(&mut answer)?;
        match answer.get(..count) {
            None | Some([]) => return Err(ErrorKind::UnexpectedEof.into()),
            Some(bytes) if bytes.ends_with(b"\n") => return Ok(()),
            Some(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ping_is_a_request_of_the_protocol() {
        assert_eq!(takt_protocol::Request::Ping.line(), PING);
    }
}
