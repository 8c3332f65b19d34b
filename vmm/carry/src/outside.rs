//! The end on the user's machine: the socket to which clients connect.

use std::fs;
use std::io::{self, ErrorKind, Read};
use std::os::fd::AsRawFd;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Instant;

use thiserror::Error;
use vmm_sys_util::epoll::{ControlOperation, Epoll, EpollEvent, EventSet};

use crate::connections::Connections;
use crate::line::{Line, LineError, Side};

/// How often the line is looked at while there are clients, in ms.
const BUSY: i32 = 2;
/// The same before Takt answers inside.
const STARTING: i32 = 50;
/// How long to wait if there is nothing to look at.
const FOR_EVER: i32 = -1;

/// Why nothing can be carried.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum OutsideError {
    #[error(transparent)]
    Line(#[from] LineError),
    #[error("cannot {what} the socket {}: {source}", path.display())]
    Socket { what: &'static str, path: PathBuf, source: io::Error },
    #[error("cannot make the socket {}: another program listens there", .0.display())]
    InUse(PathBuf),
    #[error("cannot make the socket {}: there is a file that is no socket", .0.display())]
    NotASocket(PathBuf),
    #[error("cannot wait for clients: {0}")]
    Wait(io::Error),
}

/// Makes the line, and sees that the socket can be made when the time comes.
///
/// # Errors
/// See [`OutsideError`].
pub fn prepare(line: &Path, socket: &Path) -> Result<(), OutsideError> {
    clear(socket)?;
    Ok(Line::make(line)?)
}

/// Carries connections between the socket and the line until `end` ends. The socket is there as soon as Takt
/// answers at the other end, and goes at the end.
///
/// # Errors
/// See [`OutsideError`].
pub fn run(
    line: &Path,
    socket: &Path,
    end: &mut (impl Read + AsRawFd),
) -> Result<(), OutsideError> {
    let mut line = Line::open(line, Side::Outside)?;
    let wait = Epoll::new().map_err(OutsideError::Wait)?;
    listen_to(&wait, end)?;
    let mut connections = Connections::new();
    let mut door: Option<Door> = None;
    loop {
        let idle = connections.is_empty() && door.is_some();
        let most = match (&door, idle) {
            (_, true) => FOR_EVER,
            (Some(_), false) => BUSY,
            (None, false) => STARTING,
        };
        let mut events = [EpollEvent::default(); 2];
        let count = match wait.wait(most, &mut events) {
            Err(error) if error.kind() != ErrorKind::Interrupted => {
                return Err(OutsideError::Wait(error));
            }
            other => other.unwrap_or(0),
        };
        let ends = |event: &EpollEvent| event.data() == end.as_raw_fd() as u64;
        if events.iter().take(count).any(ends) && has_ended(end) {
            return Ok(());
        }
        if let Some(door) = &door {
            while connections.has_place()
                && let Some(stream) = door.accept()
            {
                connections.add(stream);
            }
        }
        if connections.turn(&mut line, Instant::now(), || None) && door.is_none() {
            let new = Door::open(socket)?;
            listen_to(&wait, &new.listener)?;
            door = Some(new);
        }
    }
}

/// Whether what came on `end` is its end.
fn has_ended(end: &mut impl Read) -> bool {
    !matches!(end.read(&mut [0; 64]), Ok(1..))
}

fn listen_to(wait: &Epoll, what: &impl AsRawFd) -> Result<(), OutsideError> {
    let fd = what.as_raw_fd();
    let event = EpollEvent::new(EventSet::IN, fd as u64);
    wait.ctl(ControlOperation::Add, fd, event).map_err(OutsideError::Wait)
}

/// The socket; its file goes with it.
struct Door {
    listener: UnixListener,
    path: PathBuf,
}

impl Door {
    /// Its permissions are what the process's mask leaves.
    fn open(path: &Path) -> Result<Self, OutsideError> {
        clear(path)?;
        let failed = |source| OutsideError::Socket { what: "make", path: path.to_owned(), source };
        let listener = UnixListener::bind(path).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        Ok(Self { listener, path: path.to_owned() })
    }

    fn accept(&self) -> Option<UnixStream> {
        self.listener.accept().ok().map(|(stream, _)| stream)
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        // What is left behind the next run replaces.
        let _ = fs::remove_file(&self.path);
    }
}

/// Removes a socket to which no process listens, as a run that was killed leaves it. Anything else stays, and is an
/// error.
fn clear(path: &Path) -> Result<(), OutsideError> {
    let failed = |what| move |source| OutsideError::Socket { what, path: path.to_owned(), source };
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(failed("find")(error)),
        Ok(file) if !file.file_type().is_socket() => {
            return Err(OutsideError::NotASocket(path.to_owned()));
        }
        Ok(_) => {}
    }
    match UnixStream::connect(path) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            fs::remove_file(path).map_err(failed("replace"))
        }
        _ => Err(OutsideError::InUse(path.to_owned())),
    }
}

#[cfg(test)]
#[path = "outside_tests.rs"]
mod tests;
