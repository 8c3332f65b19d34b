//! Both ends of a way into a guest by vsock.
//!
//!     vsock serve PORT                  echoes on this port until it is killed; says "serving"
//!     vsock await PORT                  ends when it is connected to
//!     vsock echo BYTES COMMAND...       sends so many bytes into a command, ends its input, and compares what comes out
//!     vsock hold CID PORT OTHER         sends memory to the port that the kernel does not get; once it waits for that with the
//!                                       socket locked, connects to the other port, says "holding", and waits to be killed
//!
//! Exit status 0: what came back was right.

use std::fs::File;
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
        ["hold", cid, port, other] => number(cid).and_then(|cid| {
            let (port, other) = (number(port)?, number(other)?);
            hold(cid, port, other)
        }),
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
        let (socket, address, length) = (socket()?, address(ANY, port), ADDRESS_BYTES);
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

const ADDRESS_BYTES: libc::socklen_t = size_of::<libc::sockaddr_vm>() as libc::socklen_t;

fn socket() -> io::Result<OwnedFd> {
    // SAFETY: takes numbers only.
    let fd = unsafe { libc::socket(libc::AF_VSOCK, libc::SOCK_STREAM, 0) };
    check(fd)?;
    // SAFETY: it is new and belongs to no other value.
    Ok(unsafe { OwnedFd::from_raw_fd(fd) })
}

fn address(cid: u32, port: u32) -> libc::sockaddr_vm {
    // SAFETY: all zeros are a valid value of this structure of integers.
    let mut address: libc::sockaddr_vm = unsafe { mem::zeroed() };
    address.svm_family = libc::AF_VSOCK as libc::sa_family_t;
    (address.svm_cid, address.svm_port) = (cid, port);
    address
}

fn connect(cid: u32, port: u32) -> io::Result<UnixStream> {
    let (socket, address) = (socket()?, address(cid, port));
    let pointer = (&raw const address).cast();
    // SAFETY: the kernel reads the live structure.
    check(unsafe { libc::connect(socket.as_raw_fd(), pointer, ADDRESS_BYTES) })?;
    Ok(socket.into())
}

fn hold(cid: u32, port: u32, other: u32) -> io::Result<()> {
    let mut held = connect(cid, port)?;
    let (mut faults, page) = missing_page()?;
    let sender = thread::spawn(move || held.write_all(page));
    // The kernel's word that the sender needs the page: by then it has the lock.
    faults.read_exact(&mut [0; 32])?;
    let _other = connect(cid, other)?;
    println!("holding");
    sender.join().map_err(|_| io::Error::other("the sender died"))?
}

/// A page that the kernel gets from this process when it is needed (`userfaultfd(2)`), which gives none.
fn missing_page() -> io::Result<(File, &'static [u8])> {
    const BYTES: usize = 4096;
    // UFFDIO_API and UFFDIO_REGISTER, which read and write structures of such numbers.
    const API: (libc::c_ulong, [u64; 3]) = (0xc018_aa3f, [0xaa, 0, 0]);
    const REGISTER: libc::c_ulong = 0xc020_aa00;
    const MODE_MISSING: u64 = 1;
    // SAFETY: takes numbers only.
    let fd = unsafe { libc::syscall(libc::SYS_userfaultfd, libc::O_CLOEXEC) } as libc::c_int;
    check(fd)?;
    // SAFETY: it is new and belongs to no other value.
    let faults = unsafe { File::from_raw_fd(fd) };
    let (protection, flags) = (libc::PROT_READ, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
    // SAFETY: new memory, at a place that the kernel chooses.
    let page = unsafe { libc::mmap(std::ptr::null_mut(), BYTES, protection, flags, -1, 0) };
    if page == libc::MAP_FAILED {
        return Err(io::Error::last_os_error());
    }
    let (request, mut api) = API;
    // SAFETY: the kernel reads and writes the live structure.
    check(unsafe { libc::ioctl(fd, request, &raw mut api) })?;
    let mut range = [page as u64, BYTES as u64, MODE_MISSING, 0];
    // SAFETY: the same, and the range is the page.
    check(unsafe { libc::ioctl(fd, REGISTER, &raw mut range) })?;
    // SAFETY: it stays mapped. Only the kernel reads it.
    Ok((faults, unsafe { std::slice::from_raw_parts(page.cast(), BYTES) }))
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
