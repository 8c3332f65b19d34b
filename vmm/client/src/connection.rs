//! The client's side of the control socket.

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::mem;
use std::net::Shutdown;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use takt_protocol::{Answer, Message, Request, VERSION};

use crate::error::ClientError;

/// Takt answers within some ticks of 20 ms, or does not.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Longest answer. Takt's are far shorter; whatever else listens there has an end, too.
const ANSWER_MAX: u64 = 1 << 20;

/// A connection to Takt.
pub struct Connection(BufReader<UnixStream>);

impl Connection {
    /// Connects.
    ///
    /// # Errors
    /// If no Takt listens there.
    pub fn open(socket: &Path) -> Result<Connection, ClientError> {
        Connection::open_within(socket, PATIENCE)
    }

    /// The same with other patience for the connection itself.
    fn open_within(socket: &Path, patience: Duration) -> Result<Connection, ClientError> {
        let stream = connect(socket, patience).map_err(|source| match source.kind() {
            // A Takt that hangs accepts no connection, and the queue of its listener is full.
            ErrorKind::WouldBlock => ClientError::Lost(io::Error::new(
                ErrorKind::TimedOut,
                "it has accepted no connection in time",
            )),
            _ => ClientError::NoTakt { socket: socket.to_owned(), source },
        })?;
        let limits = stream
            .set_read_timeout(Some(PATIENCE))
            .and_then(|()| stream.set_write_timeout(Some(PATIENCE)));
        limits.map_err(ClientError::Lost)?;
        Ok(Connection(BufReader::new(stream)))
    }

    /// From now on answers may take any time.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn wait_for_ever(&mut self) -> Result<(), ClientError> {
        self.0.get_ref().set_read_timeout(None).map_err(ClientError::Lost)
    }

    /// From now on an answer may take as long as this.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn wait_for(&mut self, time: Duration) -> Result<(), ClientError> {
        self.0.get_ref().set_read_timeout(Some(time)).map_err(ClientError::Lost)
    }

    /// The number of its descriptor, as long as it is open.
    #[must_use]
    pub fn descriptor(&self) -> RawFd {
        self.0.get_ref().as_raw_fd()
    }

    /// Sends a request. That Takt has closed already is no error yet: it has said why.
    ///
    /// # Errors
    /// If the connection is lost.
    pub fn send(&mut self, request: &Request) -> Result<(), ClientError> {
        send(self.0.get_mut(), request)
    }

    /// What sends requests while another thread waits for answers.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn sender(&self) -> Result<RequestSender, ClientError> {
        self.0.get_ref().try_clone().map(RequestSender).map_err(ClientError::Lost)
    }

    /// The next answer, also as the line that came.
    ///
    /// # Errors
    /// If none comes, or it is none.
    pub fn receive(&mut self) -> Result<(String, Answer), ClientError> {
        let mut line = Vec::new();
        (&mut self.0).take(ANSWER_MAX).read_until(b'\n', &mut line).map_err(|error| {
            ClientError::Lost(match error.kind() {
                ErrorKind::WouldBlock => {
                    io::Error::new(ErrorKind::TimedOut, "nothing came in time")
                }
                _ => error,
            })
        })?;
        if line.last() != Some(&b'\n') {
            return Err(ClientError::Lost(io::Error::new(
                ErrorKind::UnexpectedEof,
                "the connection has ended",
            )));
        }
        let not_understood = |error: String| ClientError::NotUnderstood(error);
        let message: Message =
            serde_json::from_slice(&line).map_err(|error| not_understood(error.to_string()))?;
        if message.version != VERSION {
            return Err(not_understood(format!(
                "version {} instead of {VERSION}",
                message.version
            )));
        }
        let line = String::from_utf8(line).map_err(|error| not_understood(error.to_string()))?;
        Ok((line, message.answer))
    }
}

/// As [`UnixStream::connect`], which waits for ever where the listener's queue is full. `WouldBlock` if the wait was too
/// long.
fn connect(path: &Path, patience: Duration) -> io::Result<UnixStream> {
    // SAFETY: all zeros are a valid value of this structure of integers.
    let mut address: libc::sockaddr_un = unsafe { mem::zeroed() };
    address.sun_family = libc::AF_UNIX as libc::sa_family_t;
    let bytes = path.as_os_str().as_bytes();
    // The last byte stays zero. A path that begins with one, or is empty, would be no file's.
    if bytes.is_empty() || bytes.contains(&0) || bytes.len() >= address.sun_path.len() {
        return Err(io::Error::new(ErrorKind::InvalidInput, "no path that a socket can have"));
    }
    for (place, byte) in address.sun_path.iter_mut().zip(bytes) {
        *place = byte.cast_signed();
    }
    // SAFETY: takes numbers only.
    let fd = unsafe { libc::socket(libc::AF_UNIX, libc::SOCK_STREAM | libc::SOCK_CLOEXEC, 0) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: it is new and belongs to no other value.
    let stream = UnixStream::from(unsafe { OwnedFd::from_raw_fd(fd) });
    // The kernel takes the limit of writes for connecting too.
    stream.set_write_timeout(Some(patience))?;
    let length = size_of_val(&address) as libc::socklen_t;
    // SAFETY: the kernel reads the live structure, as many bytes as it has.
    let result = unsafe { libc::connect(fd, (&raw const address).cast(), length) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(stream) }
}

fn send(stream: &mut UnixStream, request: &Request) -> Result<(), ClientError> {
    match stream.write_all(&request.line()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(ClientError::Lost),
    }
}

/// The sending half of a connection.
pub struct RequestSender(UnixStream);

impl RequestSender {
    /// As [`Connection::send`].
    ///
    /// # Errors
    /// If the connection is lost.
    pub fn send(&mut self, request: &Request) -> Result<(), ClientError> {
        send(&mut self.0, request)
    }

    /// Ends the connection, also for who waits for answers.
    pub fn end(&self) {
        // One that is gone already has ended.
        let _ = self.0.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_takt_that_accepts_nobody_is_told_after_a_while() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let listener = UnixListener::bind(&path).unwrap();
        // SAFETY: takes numbers only, one of them a listener that lives.
        assert_eq!(unsafe { libc::listen(listener.as_raw_fd(), 0) }, 0);
        let patience = Duration::from_millis(50);
        let begun = Instant::now();
        let mut waiting = Vec::new();
        let error = loop {
            assert!(waiting.len() < 5, "the queue is never full");
            match Connection::open_within(&path, patience) {
                Ok(connection) => waiting.push(connection),
                Err(error) => break error,
            }
        };
        assert!(!waiting.is_empty(), "{error}");
        assert_eq!(
            error.to_string(),
            "Takt does not answer: it has accepted no connection in time"
        );
        assert_eq!(error.status(), crate::error::NO_TAKT);
        assert!(begun.elapsed() >= patience && begun.elapsed() < PATIENCE, "{:?}", begun.elapsed());
    }

    #[test]
    fn where_no_takt_can_be_the_reason_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let told = |path: &Path| Connection::open(path).map(|_| ()).unwrap_err().to_string();
        let missing = told(&folder.path().join("control"));
        assert!(missing.contains("is it running"), "{missing}");
        for path in [Path::new("").to_owned(), folder.path().join("x".repeat(108))] {
            let error = told(&path);
            assert!(error.contains("no path that a socket can have"), "{error}");
        }
    }
}
