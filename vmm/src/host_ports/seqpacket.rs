//! Connections of the kind SOCK_SEQPACKET, which the standard library lacks.
//!
//! A message is to arrive whole or not at all, in order, and each end is to know when the other
//! has gone: of the kinds of Unix sockets only this one does all three. Nothing here ever waits.
//!
//! unix(7) describes the sockets, recv(2) and send(2) the flags.

use std::ffi::c_int;
use std::io::{self, ErrorKind};
use std::os::fd::{AsRawFd, OwnedFd};

/// A connection with a client.
#[derive(Debug)]
pub struct Connection(pub OwnedFd);

/// What became of a packet to a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The client will find it.
    Yes,
    /// The client has too much to read already.
    NotNow,
    /// The client is gone.
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
        // SAFETY: the buffer is live, that long, and borrowed mutably.
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

fn is_for_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
