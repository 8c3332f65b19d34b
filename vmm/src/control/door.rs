//! The control socket's file, and what who comes through it may do.
//!
//! Without the key `viewers` the file belongs to the user who started Takt, and a user who may open it may do
//! everything. With the key a group of users may open it too, and its members see how the run stands and order
//! nothing. The kernel says who has connected (`SO_PEERCRED`, unix(7)); a client cannot say anything else of itself.

use std::fs;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::Path;

use thiserror::Error;

use crate::unix_socket::{Listener, SocketError, SocketKind};

/// Where the host's groups are (group(5)).
const GROUPS: &str = "/etc/group";

/// Why there is no control socket.
#[derive(Debug, Error)]
pub enum DoorError {
    /// There is no socket, or it cannot be shared.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The host's groups cannot be read.
    #[error("cannot look up the group \"{group}\" of `viewers` in {GROUPS}: {source}")]
    Groups {
        /// Its name.
        group: String,
        /// What the kernel said.
        source: io::Error,
    },
    /// There is no such group.
    #[error(
        "there is no group \"{0}\" in {GROUPS}: make it with groupadd, or give `viewers` the number of a group that \
         is elsewhere"
    )]
    NoGroup(String),
}

/// What a client may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rights {
    /// Everything.
    Order,
    /// See how the run stands.
    See,
}

/// The socket that listens.
pub struct Door {
    listener: Listener,
    /// The users who may order, if others may connect.
    owners: Option<Vec<u32>>,
}

impl Door {
    /// Makes the socket; `viewers` is a group, by its name or its number.
    ///
    /// # Errors
    /// See [`DoorError`].
    pub fn open(path: &Path, viewers: Option<&str>) -> Result<Door, DoorError> {
        let group = viewers.map(group).transpose()?;
        let listener = Listener::bind(path, SocketKind::Stream)?;
        let Some(group) = group else { return Ok(Door { listener, owners: None }) };
        listener.share(group)?;
        // SAFETY: takes nothing and cannot fail.
        let own = unsafe { libc::geteuid() };
        Ok(Door { listener, owners: Some(vec![0, own]) })
    }

    /// The next client, if there is one.
    pub fn accept(&self) -> Option<(UnixStream, Rights)> {
        let stream = UnixStream::from(self.listener.accept()?);
        let rights = match &self.owners {
            None => Rights::Order,
            Some(owners) if user_of(&stream).is_some_and(|user| owners.contains(&user)) => {
                Rights::Order
            }
            Some(_) => Rights::See,
        };
        Some((stream, rights))
    }

    /// As if other users had started Takt.
    #[cfg(test)]
    pub(super) fn owned_by(self, owners: &[u32]) -> Door {
        Door { owners: Some(owners.to_vec()), ..self }
    }
}

/// The number of a group.
fn group(name: &str) -> Result<u32, DoorError> {
    if let Ok(number) = name.parse() {
        return Ok(number);
    }
    let text = fs::read_to_string(GROUPS)
        .map_err(|source| DoorError::Groups { group: name.to_owned(), source })?;
    find(&text, name).ok_or_else(|| DoorError::NoGroup(name.to_owned()))
}

/// The number of a group in a text of the form of group(5).
fn find(text: &str, name: &str) -> Option<u32> {
    text.lines().find_map(|line| {
        let mut fields = line.split(':');
        let found = fields.next() == Some(name);
        fields.nth(1).filter(|_| found)?.parse().ok()
    })
}

/// The user of the process that has connected, as it was then.
fn user_of(stream: &UnixStream) -> Option<u32> {
    let mut who = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut length = size_of::<libc::ucred>() as libc::socklen_t;
    // SAFETY: both pointers are to live values, and the length is that of the first.
    let result = unsafe {
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERCRED,
            (&raw mut who).cast(),
            &raw mut length,
        )
    };
    (result == 0 && length as usize == size_of::<libc::ucred>()).then_some(who.uid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_is_found_by_its_name_or_its_number() {
        let text = "root:x:0:\nplant:x:1001:anna,bert\nbad:x:many:\nshort\n";
        assert_eq!((find(text, "plant"), find(text, "root")), (Some(1001), Some(0)));
        for none in ["plan", "bad", "short", "anna", "x", "1001"] {
            assert_eq!(find(text, none), None, "{none}");
        }
        assert_eq!(group("1001").unwrap(), 1001);
        let error = group("no-such-group").unwrap_err().to_string();
        assert!(
            error.starts_with("there is no group \"no-such-group\" in /etc/group: "),
            "{error}"
        );
    }

    #[test]
    fn the_kernel_says_who_has_connected() {
        let (one, _other) = UnixStream::pair().unwrap();
        // SAFETY: takes nothing and cannot fail.
        assert_eq!(user_of(&one), Some(unsafe { libc::geteuid() }));
    }
}
