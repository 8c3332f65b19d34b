//! Connects standard input and output to a port of a guest, as ssh's `ProxyCommand` has to.
//!
//! Each direction ends by itself: ssh may be done with sending while the guest still answers.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read, Write};
use std::mem;
use std::net::Shutdown;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::thread;

use takt_plan::Cid;

use crate::ShellError;

/// Bytes under way in one direction.
const BUFFER: usize = 1 << 16;

/// A port of a guest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    cid: Cid,
    port: u32,
}

impl Place {
    /// What `connect CID PORT` means; `None` for other words, such as a partition file that is called `connect`.
    pub fn of(words: &[OsString]) -> Option<Self> {
        let [connect, cid, port] = words else { return None };
        let number = |word: &OsString| word.to_str()?.parse().ok();
        let (cid, port) = (Cid(number(cid)?), number(port)?);
        (connect == "connect").then_some(Self { cid, port })
    }

    /// Connects standard input and output to it, until both directions have ended.
    ///
    /// # Errors
    /// If there is no connection, or if it breaks off.
    pub fn connect(self) -> Result<(), ShellError> {
        let guest = self.open()?;
        // SAFETY: nothing else in this process writes to standard output.
        let output = unsafe { File::from_raw_fd(libc::STDOUT_FILENO) };
        relay(io::stdin(), output, guest).map_err(ShellError::Broken)
    }

    /// A connected socket. The standard library has a type for streams of this kind, whatever their addresses are.
    fn open(self) -> Result<UnixStream, ShellError> {
        // SAFETY: takes numbers only.
        let fd = unsafe { libc::socket(libc::AF_VSOCK, libc::SOCK_STREAM | libc::SOCK_CLOEXEC, 0) };
        if fd < 0 {
            return Err(ShellError::NoSockets(io::Error::last_os_error()));
        }
        // SAFETY: it is new and belongs to no other value.
        let socket = unsafe { OwnedFd::from_raw_fd(fd) };
        // SAFETY: all zeros are a valid value of this structure of integers.
        let mut address: libc::sockaddr_vm = unsafe { mem::zeroed() };
        address.svm_family = libc::AF_VSOCK as libc::sa_family_t;
        address.svm_cid = self.cid.0;
        address.svm_port = self.port;
        let length = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the kernel reads the live structure, as many bytes as it has.
        let result =
            unsafe { libc::connect(socket.as_raw_fd(), (&raw const address).cast(), length) };
        if result < 0 {
            let source = io::Error::last_os_error();
            return Err(ShellError::Unreached { cid: self.cid, port: self.port, source });
        }
        Ok(socket.into())
    }
}

/// Copies both ways until both have ended. An end of the input is passed on, and one of the guest closes the output.
fn relay(
    input: impl Read + Send + 'static,
    output: impl Write,
    guest: UnixStream,
) -> io::Result<()> {
    let to_guest = guest.try_clone()?;
    let sender = thread::spawn(move || {
        copy(input, &to_guest)?;
        to_guest.shutdown(Shutdown::Write)
    });
    copy(&guest, output)?;
    // What a sender finds at a guest that has closed both directions is no defect.
    let gone = |error: &io::Error| {
        matches!(error.kind(), io::ErrorKind::BrokenPipe | io::ErrorKind::NotConnected)
    };
    match sender.join() {
        Ok(Err(error)) if !gone(&error) => Err(error),
        Ok(_) => Ok(()),
        Err(_) => Err(io::Error::other("the thread that sends died")),
    }
}

fn copy(mut from: impl Read, mut to: impl Write) -> io::Result<()> {
    let mut buffer = vec![0; BUFFER];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => to.write_all(buffer.get(..count).unwrap_or_default())?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// An end that does not come is a failure after this time.
    const PATIENCE: Duration = Duration::from_secs(20);

    struct Ends {
        input: UnixStream,
        output: UnixStream,
        guest: UnixStream,
        relay: thread::JoinHandle<io::Result<()>>,
    }

    fn ends() -> Ends {
        let patient = |stream: UnixStream| {
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
            stream
        };
        let pair = || {
            let (one, other) = UnixStream::pair().unwrap();
            (patient(one), patient(other))
        };
        let ((input, stdin), (output, stdout), (guest, socket)) = (pair(), pair(), pair());
        let relay = thread::spawn(move || relay(stdin, stdout, socket));
        Ends { input, output, guest, relay }
    }

    fn rest(mut stream: &UnixStream) -> Vec<u8> {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn the_guest_answers_when_the_input_has_ended() {
        let Ends { input, output, mut guest, relay } = ends();
        (&input).write_all(b"question").unwrap();
        drop(input);
        assert_eq!(rest(&guest), b"question");
        guest.write_all(b"answer").unwrap();
        drop(guest);
        assert_eq!(rest(&output), b"answer");
        relay.join().unwrap().unwrap();
    }

    #[test]
    fn the_guest_may_end_first() {
        let Ends { input, output, guest, relay } = ends();
        guest.shutdown(Shutdown::Write).unwrap();
        assert_eq!(rest(&output), b"");
        (&input).write_all(b"still").unwrap();
        drop(input);
        assert_eq!(rest(&guest), b"still");
        relay.join().unwrap().unwrap();
    }

    #[test]
    fn a_guest_that_has_gone_ends_it_with_the_next_that_is_sent() {
        let Ends { input, output, guest, relay } = ends();
        drop(guest);
        assert_eq!(rest(&output), b"");
        (&input).write_all(b"lost").unwrap();
        relay.join().unwrap().unwrap();
    }

    #[test]
    fn more_than_any_buffer_goes_both_ways_at_once() {
        let Ends { input, output, guest, relay } = ends();
        let noise: Vec<u8> =
            (0..4_u32 << 20).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let sent = noise.clone();
        let sender = thread::spawn(move || (&input).write_all(&sent).unwrap());
        let echo = thread::spawn(move || copy(&guest, &guest).unwrap());
        assert!(rest(&output) == noise);
        for thread in [sender, echo] {
            thread.join().unwrap();
        }
        relay.join().unwrap().unwrap();
    }

    #[test]
    fn only_numbers_are_a_place() {
        let place =
            |words: &[&str]| Place::of(&words.iter().map(OsString::from).collect::<Vec<_>>());
        assert_eq!(place(&["connect", "3", "22"]), Some(Place { cid: Cid(3), port: 22 }));
        for other in [
            &["connect"][..],
            &["connect", "hmi"],
            &["connect", "hmi", "22"],
            &["connect", "-1", "22"],
            &["plant.toml", "3", "22"],
            &["connect", "3", "22", "x"],
        ] {
            assert_eq!(place(other), None, "{other:?}");
        }
    }
}
