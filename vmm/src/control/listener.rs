//! The socket's file.
//!
//! Its permissions are all the protection there is, so there is no moment without them: the mode is
//! set on the descriptor before it is bound to a path, and the kernel gives the file that mode
//! (`unix_bind_bsd` in its `net/unix/af_unix.c`). The standard library binds at once, which is why
//! this one is made by hand.

use std::ffi::c_int;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Connections that the kernel keeps until they are accepted.
const BACKLOG: c_int = 32;
/// Longest path of a socket in bytes: `sun_path` of unix(7), less its NUL.
pub const PATH_MAX: usize = 107;

/// Why there is no control socket.
#[derive(Debug, Error)]
pub enum SocketError {
    /// The host refuses something.
    #[error("cannot {what} the control socket {}: {source}", path.display())]
    Host {
        /// What was attempted.
        what: &'static str,
        /// Of the socket.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// Somebody listens there.
    #[error("cannot make the control socket {}: another program listens there", .0.display())]
    InUse(PathBuf),
    /// Something else has that path, and is not Takt's to remove.
    #[error("cannot make the control socket {}: there is a file that is no socket", .0.display())]
    NotASocket(PathBuf),
}

/// A socket that listens; its file goes with it.
#[derive(Debug)]
pub struct Listener {
    socket: UnixListener,
    path: PathBuf,
    /// Device and inode of the file.
    file: (u64, u64),
}

impl Listener {
    /// Makes the socket, for its owner only. One to which nobody listens, as a Takt that was killed
    /// leaves it, is replaced; anything else stays.
    ///
    /// # Errors
    /// See [`SocketError`].
    pub fn bind(path: &Path) -> Result<Listener, SocketError> {
        let cannot = |what| move |source| SocketError::Host { what, path: path.to_owned(), source };
        let fd = new_socket().map_err(cannot("make"))?;
        let bound = match bind(&fd, path) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => {
                remove_stale(path)?;
                bind(&fd, path)
            }
            other => other,
        };
        bound.map_err(cannot("make"))?;
        let file = fs::symlink_metadata(path).map_err(cannot("find"))?;
        // SAFETY: takes integers only.
        check(unsafe { libc::listen(fd.as_raw_fd(), BACKLOG) }).map_err(cannot("listen to"))?;
        let socket = UnixListener::from(fd);
        Ok(Listener { socket, path: path.to_owned(), file: (file.dev(), file.ino()) })
    }

    /// The next connection, if there is one. It never waits.
    pub(super) fn accept(&self) -> Option<UnixStream> {
        let (stream, _) = self.socket.accept().ok()?;
        stream.set_nonblocking(true).ok()?;
        Some(stream)
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

/// Removes the socket of a process that is gone.
fn remove_stale(path: &Path) -> Result<(), SocketError> {
    let cannot = |what| move |source| SocketError::Host { what, path: path.to_owned(), source };
    let file = fs::symlink_metadata(path).map_err(cannot("find"))?;
    if !file.file_type().is_socket() {
        return Err(SocketError::NotASocket(path.to_owned()));
    }
    match UnixStream::connect(path) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            fs::remove_file(path).map_err(cannot("replace"))
        }
        _ => Err(SocketError::InUse(path.to_owned())),
    }
}

fn new_socket() -> io::Result<OwnedFd> {
    let kind = libc::SOCK_STREAM | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: takes integers only.
    let fd = check(unsafe { libc::socket(libc::AF_UNIX, kind, 0) })?;
    // SAFETY: the descriptor is new and nobody else's.
    let fd = unsafe { OwnedFd::from_raw_fd(fd) };
    // SAFETY: takes integers only.
    check(unsafe { libc::fchmod(fd.as_raw_fd(), 0o600) })?;
    Ok(fd)
}

fn bind(fd: &OwnedFd, path: &Path) -> io::Result<()> {
    let mut address =
        libc::sockaddr_un { sun_family: libc::AF_UNIX as libc::sa_family_t, sun_path: [0; 108] };
    let bytes = path.as_os_str().as_bytes();
    if bytes.len() > PATH_MAX {
        return Err(ErrorKind::InvalidFilename.into());
    }
    for (to, from) in address.sun_path.iter_mut().zip(bytes) {
        *to = *from as libc::c_char;
    }
    let length = size_of::<libc::sockaddr_un>() as libc::socklen_t;
    // SAFETY: the address is live and has this length.
    check(unsafe { libc::bind(fd.as_raw_fd(), (&raw const address).cast(), length) }).map(|_| ())
}

fn check(result: c_int) -> io::Result<c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
