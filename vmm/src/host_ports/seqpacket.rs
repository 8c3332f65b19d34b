//! Unix sockets of the kind SOCK_SEQPACKET, which the standard library lacks.
//!
//! A message is to arrive whole or not at all, in order, and each end is to know when the other
//! has gone: of the kinds of Unix sockets only this one does all three. Nothing here ever waits.
//!
//! unix(7) describes the sockets, recv(2) and send(2) the flags.

use std::ffi::c_int;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Connections that the kernel keeps until they are accepted.
const BACKLOG: c_int = 8;

/// Why there is no socket.
#[derive(Debug, Error)]
pub enum SocketError {
    /// The host refuses something.
    #[error("cannot {what} the socket {}: {source}", path.display())]
    Host {
        /// What was attempted.
        what: &'static str,
        /// Of the socket.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// Something else has that path, and is not Takt's to remove.
    #[error("{} is there already and is no socket that was left behind", .0.display())]
    Taken(PathBuf),
}

/// A socket that listens; its file goes with it.
#[derive(Debug)]
pub struct Listener {
    fd: OwnedFd,
    path: PathBuf,
    /// Device and inode of the file.
    file: (u64, u64),
}

impl Listener {
    /// Makes the socket, for its owner only (mode 0600). One that is there and to which nobody
    /// listens, as a Takt that was killed leaves it, is replaced; anything else stays.
    ///
    /// # Errors
    /// See [`SocketError`].
    pub fn bind(path: &Path) -> Result<Self, SocketError> {
        let cannot = |what| move |source| SocketError::Host { what, path: path.to_owned(), source };
        let fd = socket().map_err(cannot("make"))?;
        // The kernel takes the mode of the new file from the descriptor (unix_bind_bsd in the
        // kernel's net/unix/af_unix.c), so there is no moment in which others could connect.
        // SAFETY: takes integers only.
        check(unsafe { libc::fchmod(fd.as_raw_fd(), 0o600) }).map_err(cannot("guard"))?;
        if let Err(error) = with_address(path, |a, length| {
            // SAFETY: the address is live and has this length.
            unsafe { libc::bind(fd.as_raw_fd(), a, length) }
        }) {
            if error.kind() != ErrorKind::AddrInUse {
                return Err(cannot("make")(error));
            }
            if !is_left_behind(path) {
                return Err(SocketError::Taken(path.to_owned()));
            }
            fs::remove_file(path).map_err(cannot("replace"))?;
            with_address(path, |a, length| {
                // SAFETY: as above.
                unsafe { libc::bind(fd.as_raw_fd(), a, length) }
            })
            .map_err(cannot("make"))?;
        }
        let file = fs::symlink_metadata(path).map_err(cannot("find"))?;
        let listener = Self { fd, path: path.to_owned(), file: (file.dev(), file.ino()) };
        // SAFETY: takes integers only.
        check(unsafe { libc::listen(listener.fd.as_raw_fd(), BACKLOG) })
            .map_err(cannot("listen to"))?;
        Ok(listener)
    }

    /// The next connection, if there is one.
    #[must_use]
    pub fn accept(&self) -> Option<Connection> {
        let flags = libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
        let none = std::ptr::null_mut();
        // SAFETY: null pointers say that the other end's address is not wanted.
        let fd = unsafe { libc::accept4(self.fd.as_raw_fd(), none, none.cast(), flags) };
        if fd < 0 {
            return None;
        }
        // SAFETY: the descriptor is new and nobody else's.
        Some(Connection(unsafe { OwnedFd::from_raw_fd(fd) }))
    }
}

impl AsRawFd for Listener {
    fn as_raw_fd(&self) -> c_int {
        self.fd.as_raw_fd()
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let is_own = |file: fs::Metadata| (file.dev(), file.ino()) == self.file;
        if fs::symlink_metadata(&self.path).is_ok_and(is_own) {
            // What is left behind the next run replaces.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A connection with a client.
#[derive(Debug)]
pub struct Connection(OwnedFd);

/// What became of a packet to a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The client will find it.
    Yes,
    /// The client has too much to read already.
    NotNow,
    /// There is nobody any more.
    Gone,
}

/// What came from a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Came {
    /// A packet of this length.
    Packet(usize),
    /// Nothing at present.
    Nothing,
    /// An empty packet, or one that is longer than the buffer.
    Wrong,
    /// Nothing, and nothing will come any more.
    End,
}

impl Connection {
    /// Sends a packet.
    #[must_use]
    pub fn send(&self, packet: &[u8]) -> Sent {
        let flags = libc::MSG_DONTWAIT | libc::MSG_NOSIGNAL;
        // SAFETY: the packet is live and that long.
        let sent =
            unsafe { libc::send(self.0.as_raw_fd(), packet.as_ptr().cast(), packet.len(), flags) };
        match sent {
            0.. => Sent::Yes,
            _ if is_for_later(&io::Error::last_os_error()) => Sent::NotNow,
            _ => Sent::Gone,
        }
    }

    /// Takes the next packet.
    #[must_use]
    pub fn receive(&self, buffer: &mut [u8]) -> Came {
        // With MSG_TRUNC, the length is that of the packet and not of what fitted.
        match self.recv(buffer, libc::MSG_TRUNC) {
            // Both an empty packet and the end read as nothing.
            Ok(0) if self.has(libc::POLLRDHUP) => Came::End,
            Ok(length) if length == 0 || length > buffer.len() => Came::Wrong,
            Ok(length) => Came::Packet(length),
            Err(error) if is_for_later(&error) => Came::Nothing,
            Err(_) => Came::End,
        }
    }

    /// Whether the client has closed its end.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.has(libc::POLLHUP | libc::POLLERR)
    }

    /// Whether nothing that the client sent is left.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        !matches!(self.recv(&mut [0], libc::MSG_PEEK), Ok(1..))
    }

    fn recv(&self, buffer: &mut [u8], flags: c_int) -> io::Result<usize> {
        let flags = flags | libc::MSG_DONTWAIT;
        let (start, length) = (buffer.as_mut_ptr().cast(), buffer.len());
        // SAFETY: the buffer is live, that long, and nobody else's.
        let length = unsafe { libc::recv(self.0.as_raw_fd(), start, length, flags) };
        usize::try_from(length).map_err(|_| io::Error::last_os_error())
    }

    fn has(&self, events: libc::c_short) -> bool {
        let mut poll = libc::pollfd { fd: self.0.as_raw_fd(), events, revents: 0 };
        // SAFETY: one live structure; a time-out of 0 does not wait.
        unsafe { libc::poll(&raw mut poll, 1, 0) > 0 && poll.revents & events != 0 }
    }
}

impl AsRawFd for Connection {
    fn as_raw_fd(&self) -> c_int {
        self.0.as_raw_fd()
    }
}

/// Connects as a client does.
///
/// # Errors
/// What the kernel says.
pub fn connect(path: &Path) -> io::Result<Connection> {
    let fd = socket()?;
    with_address(path, |address, length| {
        // SAFETY: the address is live and has this length.
        unsafe { libc::connect(fd.as_raw_fd(), address, length) }
    })?;
    Ok(Connection(fd))
}

/// True for a socket to which nobody listens.
fn is_left_behind(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket())
        && connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
}

fn socket() -> io::Result<OwnedFd> {
    let kind = libc::SOCK_SEQPACKET | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: takes integers only.
    let fd = check(unsafe { libc::socket(libc::AF_UNIX, kind, 0) })?;
    // SAFETY: the descriptor is new and nobody else's.
    Ok(unsafe { OwnedFd::from_raw_fd(fd) })
}

fn with_address(
    path: &Path,
    call: impl FnOnce(*const libc::sockaddr, libc::socklen_t) -> c_int,
) -> io::Result<()> {
    let mut address = libc::sockaddr_un { sun_family: libc::AF_UNIX as u16, sun_path: [0; 108] };
    let bytes = path.as_os_str().as_bytes();
    // The last byte stays a NUL.
    if bytes.len() >= address.sun_path.len() {
        return Err(ErrorKind::InvalidFilename.into());
    }
    for (to, from) in address.sun_path.iter_mut().zip(bytes) {
        *to = *from as libc::c_char;
    }
    let length = size_of::<libc::sockaddr_un>() as libc::socklen_t;
    check(call((&raw const address).cast(), length)).map(|_| ())
}

fn is_for_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

fn check(result: c_int) -> io::Result<c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
