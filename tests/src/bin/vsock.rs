//! Both ends of a way into a guest by vsock.
//!
//!     vsock serve PORT                  echoes on this port until it is killed; says "serving"
//!     vsock await PORT                  ends when it is connected to
//!     vsock echo BYTES COMMAND...       sends so many bytes into a command, ends its input, and compares what comes out
//!
//! Exit status 0: what came back was right.

use std::io::{self, Read, Write};
use std::mem;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::process::{Command, ExitCode, Stdio};
use std::thread;

use takt_tests::random::Random;

/// `VMADDR_CID_ANY`.
const ANY: u32 = u32::MAX;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["serve", port] => number(port).and_then(serve),
        ["await", port] => number(port).and_then(Listener::open).and_then(|l| l.accept().map(drop)),
        ["echo", bytes, program, ref rest @ ..] => {
            number(bytes).and_then(|bytes| echo(bytes, program, rest))
        }
        _ => Err(io::Error::other("see the head of vsock.rs")),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vsock: {words:?}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn number(word: &str) -> io::Result<u32> {
    word.parse().map_err(io::Error::other)
}

fn serve(port: u32) -> io::Result<()> {
    let listener = Listener::open(port)?;
    println!("serving");
    loop {
        let mut client = listener.accept()?;
        // A client that goes before its bytes are back is no matter.
        thread::spawn(move || io::copy(&mut client.try_clone()?, &mut client));
    }
}

struct Listener(OwnedFd);

impl Listener {
    fn open(port: u32) -> io::Result<Self> {
        // SAFETY: takes numbers only.
        let fd = unsafe { libc::socket(libc::AF_VSOCK, libc::SOCK_STREAM, 0) };
        check(fd)?;
        // SAFETY: it is new and belongs to no other value.
        let socket = unsafe { OwnedFd::from_raw_fd(fd) };
        // SAFETY: all zeros are a valid value of this structure of integers.
        let mut address: libc::sockaddr_vm = unsafe { mem::zeroed() };
        address.svm_family = libc::AF_VSOCK as libc::sa_family_t;
        (address.svm_cid, address.svm_port) = (ANY, port);
        let length = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the kernel reads the live structure.
        check(unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) })?;
        // SAFETY: takes numbers only.
        check(unsafe { libc::listen(socket.as_raw_fd(), 8) })?;
        Ok(Self(socket))
    }

    /// The next connection, of the type that the standard library has for streams of this kind.
    fn accept(&self) -> io::Result<UnixStream> {
        let (address, length) = (std::ptr::null_mut(), std::ptr::null_mut());
        // SAFETY: the kernel writes no address where there is no pointer for one.
        let fd = unsafe { libc::accept(self.0.as_raw_fd(), address, length) };
        check(fd)?;
        // SAFETY: it is new and belongs to no other value.
        Ok(unsafe { OwnedFd::from_raw_fd(fd) }.into())
    }
}

fn echo(bytes: u32, program: &str, rest: &[&str]) -> io::Result<()> {
    let mut random = Random::new(bytes.into());
    let noise: Vec<u8> = (0..bytes).map(|_| random.number() as u8).collect();
    let mut way =
        Command::new(program).args(rest).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
    let mut input = way.stdin.take().ok_or_else(|| io::Error::other("no input"))?;
    let sent = noise.clone();
    let sender = thread::spawn(move || input.write_all(&sent));
    let mut back = Vec::with_capacity(noise.len());
    way.stdout.take().ok_or_else(|| io::Error::other("no output"))?.read_to_end(&mut back)?;
    sender.join().map_err(|_| io::Error::other("the sender died"))??;
    let status = way.wait()?;
    if !status.success() {
        return Err(io::Error::other(format!("{program}: {status}")));
    }
    if back == noise { Ok(()) } else { Err(io::Error::other("other bytes came back")) }
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
