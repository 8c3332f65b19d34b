//! The client's side of the control socket.

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsRawFd, RawFd};
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
        let stream = UnixStream::connect(socket)
            .map_err(|source| ClientError::NoTakt { socket: socket.to_owned(), source })?;
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
