//! Sockets, as streams.

#![allow(unsafe_code)]

use std::fs::File;
use std::io::{self, Read, Write};
use std::mem;
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::net::UnixStream;

use crate::{BYTES, Ends, Receiving, Sending};

struct Stream<S>(S);

impl<S: Write + Send> Sending for Stream<S> {
    fn send(&mut self, message: &[u8; BYTES]) -> io::Result<()> {
        self.0.write_all(message)
    }
}

impl<S: Read + Send> Receiving for Stream<S> {
    fn receive(&mut self, message: &mut [u8; BYTES]) -> io::Result<()> {
        self.0.read_exact(message)
    }
}

/// Two connected sockets of the local family.
pub fn pair() -> io::Result<Ends> {
    let (from, to) = UnixStream::pair()?;
    Ok((Box::new(Stream(from)), Box::new(Stream(to))))
}

/// TCP over the loopback interface.
pub fn tcp() -> io::Result<Ends> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let from = TcpStream::connect(listener.local_addr()?)?;
    let (to, _) = listener.accept()?;
    from.set_nodelay(true)?;
    Ok((Box::new(Stream(from)), Box::new(Stream(to))))
}

/// The socket family between virtual machines and their host, within one machine.
pub fn vsock() -> io::Result<Ends> {
    let listener = vsock_socket()?;
    let mut address = vsock_address(libc::VMADDR_CID_ANY, libc::VMADDR_PORT_ANY);
    let mut length = size_of_val(&address) as libc::socklen_t;
    let pointer = (&raw mut address).cast::<libc::sockaddr>();
    // SAFETY: `address` is as long as the kernel is told; it lives through the calls.
    let listening = unsafe {
        check(libc::bind(listener.as_raw_fd(), pointer, length))
            .and_then(|_| check(libc::listen(listener.as_raw_fd(), 1)))
            .and_then(|_| check(libc::getsockname(listener.as_raw_fd(), pointer, &raw mut length)))
    };
    listening?;
    let from = vsock_socket()?;
    let target = vsock_address(libc::VMADDR_CID_LOCAL, address.svm_port);
    let length = size_of_val(&target) as libc::socklen_t;
    let pointer = (&raw const target).cast::<libc::sockaddr>();
    // SAFETY: as above.
    check(unsafe { libc::connect(from.as_raw_fd(), pointer, length) })?;
    // SAFETY: no address is asked for.
    let to = check(unsafe {
        libc::accept(listener.as_raw_fd(), std::ptr::null_mut(), std::ptr::null_mut())
    })?;
    // SAFETY: a new descriptor that has no other owner.
    let to = unsafe { OwnedFd::from_raw_fd(to) };
    Ok((Box::new(Stream(File::from(from))), Box::new(Stream(File::from(to)))))
}

fn vsock_socket() -> io::Result<OwnedFd> {
    // SAFETY: no memory is involved.
    let socket =
        check(unsafe { libc::socket(libc::AF_VSOCK, libc::SOCK_STREAM | libc::SOCK_CLOEXEC, 0) })?;
    // SAFETY: a new descriptor that has no other owner.
    Ok(unsafe { OwnedFd::from_raw_fd(socket) })
}

fn vsock_address(cid: u32, port: u32) -> libc::sockaddr_vm {
    // SAFETY: all zero is a valid `sockaddr_vm`.
    let mut address: libc::sockaddr_vm = unsafe { mem::zeroed() };
    address.svm_family = libc::AF_VSOCK as libc::sa_family_t;
    address.svm_cid = cid;
    address.svm_port = port;
    address
}

fn check(result: i32) -> io::Result<i32> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}
