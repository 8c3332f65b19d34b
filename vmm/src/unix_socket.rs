//! A Unix socket that listens, and its file.
//!
//! Takt lets other programs in by sockets: to its control, and to the ends of channels on the host.
//! The permissions of the file are all the protection that such a socket has, so there is no moment
//! without them: the mode is set on the descriptor before it is bound to a path, and the kernel
//! gives the file that mode (`unix_bind_bsd` in its `net/unix/af_unix.c`). The standard library
//! binds at once, and knows no SOCK_SEQPACKET. So this one is made by hand. Nothing here ever waits.

use std::ffi::c_int;
use std::fs::{self, OpenOptions, Permissions};
use std::io::{self, ErrorKind};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};

use takt_plan::SOCKET_PATH_MAX;
use thiserror::Error;

/// Connections that the kernel keeps until they are accepted.
const BACKLOG: c_int = 32;

/// What a connection carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SocketKind {
    /// Bytes (SOCK_STREAM).
    Stream,
    /// Packets, whole and in order (SOCK_SEQPACKET).
    Packets,
}

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
    /// A process listens there.
    #[error("cannot make the socket {}: another program listens there", .0.display())]
    InUse(PathBuf),
    /// Something else has that path, and is not Takt's to remove.
    #[error("cannot make the socket {}: there is a file that is no socket", .0.display())]
    NotASocket(PathBuf),
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
    /// Makes the socket, for its owner only (mode 0600). A socket to which no process listens, as
    /// a Takt that was killed leaves it, is replaced. Anything else stays.
    ///
    /// # Errors
    /// See [`SocketError`].
    pub fn bind(path: &Path, kind: SocketKind) -> Result<Self, SocketError> {
        let cannot = |what| move |source| SocketError::Host { what, path: path.to_owned(), source };
        let fd = socket(kind).map_err(cannot("make"))?;
        // SAFETY: takes integers only.
        check(unsafe { libc::fchmod(fd.as_raw_fd(), 0o600) }).map_err(cannot("guard"))?;
        let bound = match bind(&fd, path) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => {
                remove_stale(path, kind)?;
                bind(&fd, path)
            }
            other => other,
        };
        bound.map_err(cannot("make"))?;
        let file = fs::symlink_metadata(path).map_err(cannot("find"))?;
        let listener = Self { fd, path: path.to_owned(), file: (file.dev(), file.ino()) };
        // SAFETY: takes integers only.
        check(unsafe { libc::listen(listener.fd.as_raw_fd(), BACKLOG) })
            .map_err(cannot("listen to"))?;
        Ok(listener)
    }

    /// Lets the members of a group connect too (mode 0660).
    ///
    /// # Errors
    /// If the host refuses it, or another file has the path by now.
    pub fn share(&self, group: u32) -> Result<(), SocketError> {
        let cannot = |source| SocketError::Host { what: "share", path: self.path.clone(), source };
        // Who may write to the folder can have put another file there, which must not be shared instead.
        let flags = libc::O_PATH | libc::O_NOFOLLOW;
        let file = OpenOptions::new().read(true).custom_flags(flags).open(&self.path);
        let file = file.map_err(cannot)?;
        let found = file.metadata().map_err(cannot)?;
        if (found.dev(), found.ino()) != self.file {
            return Err(cannot(io::Error::other("another file has its path")));
        }
        let place = format!("/proc/self/fd/{}", file.as_raw_fd());
        chown(&place, None, Some(group)).map_err(cannot)?;
        fs::set_permissions(&place, Permissions::from_mode(0o660)).map_err(cannot)
    }

    /// The next connection, if there is one; it never waits either.
    #[must_use]
    pub fn accept(&self) -> Option<OwnedFd> {
        let flags = libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
        let none = std::ptr::null_mut();
        // SAFETY: null pointers say that the other end's address is not wanted.
        let fd = unsafe { libc::accept4(self.fd.as_raw_fd(), none, none.cast(), flags) };
        // SAFETY: the descriptor is new and has no other owner.
        check(fd).ok().map(|fd| unsafe { OwnedFd::from_raw_fd(fd) })
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

/// Connects as a client does.
///
/// # Errors
/// What the kernel says.
pub fn connect(path: &Path, kind: SocketKind) -> io::Result<OwnedFd> {
    let fd = socket(kind)?;
    with_address(path, |address, length| {
        // SAFETY: the address is live and has this length.
        unsafe { libc::connect(fd.as_raw_fd(), address, length) }
    })?;
    Ok(fd)
}

/// Removes the socket of a process that is gone.
fn remove_stale(path: &Path, kind: SocketKind) -> Result<(), SocketError> {
    let cannot = |what| move |source| SocketError::Host { what, path: path.to_owned(), source };
    let file = fs::symlink_metadata(path).map_err(cannot("find"))?;
    if !file.file_type().is_socket() {
        return Err(SocketError::NotASocket(path.to_owned()));
    }
    match connect(path, kind) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            fs::remove_file(path).map_err(cannot("replace"))
        }
        _ => Err(SocketError::InUse(path.to_owned())),
    }
}

fn socket(kind: SocketKind) -> io::Result<OwnedFd> {
    let kind = match kind {
        SocketKind::Stream => libc::SOCK_STREAM,
        SocketKind::Packets => libc::SOCK_SEQPACKET,
    };
    let kind = kind | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: takes integers only.
    let fd = check(unsafe { libc::socket(libc::AF_UNIX, kind, 0) })?;
    // SAFETY: the descriptor is new and has no other owner.
    Ok(unsafe { OwnedFd::from_raw_fd(fd) })
}

fn bind(fd: &OwnedFd, path: &Path) -> io::Result<()> {
    with_address(path, |address, length| {
        // SAFETY: the address is live and has this length.
        unsafe { libc::bind(fd.as_raw_fd(), address, length) }
    })
}

fn with_address(
    path: &Path,
    call: impl FnOnce(*const libc::sockaddr, libc::socklen_t) -> c_int,
) -> io::Result<()> {
    let family = libc::AF_UNIX as libc::sa_family_t;
    let mut address = libc::sockaddr_un { sun_family: family, sun_path: [0; SOCKET_PATH_MAX + 1] };
    let bytes = path.as_os_str().as_bytes();
    if bytes.len() > SOCKET_PATH_MAX {
        return Err(ErrorKind::InvalidFilename.into());
    }
    for (to, from) in address.sun_path.iter_mut().zip(bytes) {
        *to = *from as libc::c_char;
    }
    let length = size_of::<libc::sockaddr_un>() as libc::socklen_t;
    check(call((&raw const address).cast(), length)).map(|_| ())
}

fn check(result: c_int) -> io::Result<c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

#[cfg(test)]
#[path = "unix_socket_tests.rs"]
mod tests;
