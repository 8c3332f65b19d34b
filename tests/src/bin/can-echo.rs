//! Returns every frame of a CAN bus as it is, by the host's own driver and SocketCAN.
//!
//!     can-echo INTERFACE
//!
//! Brings the interface up at 500 kbit/s, says so, and ends when it has had frames and then none for
//! two seconds. Frames are numbered by their eight bytes, from 1; what is missing or out of order is
//! counted.

use std::error::Error;
use std::ffi::CString;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::mem::size_of;
use std::os::fd::{AsRawFd, FromRawFd};
use std::process::ExitCode;

const BITS_PER_SECOND: u32 = 500_000;
/// Bytes of `struct can_frame`: identifier, length, padding, eight bytes (kernel,
/// `include/uapi/linux/can.h`).
const FRAME: usize = 16;

/// An attribute of a netlink message, padded (kernel, `include/uapi/linux/netlink.h`).
fn attribute(kind: u16, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.extend((content.len() as u16 + 4).to_ne_bytes());
    bytes.extend(kind.to_ne_bytes());
    bytes.extend(content);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// The message that gives an interface its bit rate and brings it up: a header, `struct ifinfomsg`,
/// and what belongs to links of the kind "can" (kernel, `include/uapi/linux/rtnetlink.h`,
/// `if_link.h`, `can/netlink.h`).
fn bring_up(index: u32) -> Vec<u8> {
    const HEADERS: usize = 32;
    const UP: u32 = libc::IFF_UP as u32;
    const INFO_KIND: u16 = 1;
    const INFO_DATA: u16 = 2;
    const CAN_BITTIMING: u16 = 1;
    // Eight numbers, of which the kernel calculates all but the first.
    let mut timing = [0; 32];
    timing[..4].copy_from_slice(&BITS_PER_SECOND.to_ne_bytes());
    let data = attribute(INFO_DATA, &attribute(CAN_BITTIMING, &timing));
    let info = attribute(libc::IFLA_LINKINFO, &[attribute(INFO_KIND, b"can"), data].concat());

    let mut message = Vec::new();
    message.extend(((HEADERS + info.len()) as u32).to_ne_bytes());
    message.extend(libc::RTM_NEWLINK.to_ne_bytes());
    message.extend(((libc::NLM_F_REQUEST | libc::NLM_F_ACK) as u16).to_ne_bytes());
    // Sequence number and sender; family and type of the device.
    message.extend([0; 8]);
    message.extend([0; 4]);
    for number in [index, UP, UP] {
        message.extend(number.to_ne_bytes());
    }
    message.extend(info);
    message
}

/// A socket, as a file.
fn socket(domain: i32, protocol: i32) -> io::Result<File> {
    // SAFETY: takes numbers only.
    let fd = unsafe { libc::socket(domain, libc::SOCK_RAW | libc::SOCK_CLOEXEC, protocol) };
    if fd < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor is new and has no other owner.
    Ok(unsafe { File::from_raw_fd(fd) })
}

fn set_up(index: u32) -> io::Result<()> {
    let mut netlink = socket(libc::AF_NETLINK, libc::NETLINK_ROUTE)?;
    netlink.write_all(&bring_up(index))?;
    let mut answer = [0; 256];
    let length = netlink.read(&mut answer)?;
    // Behind the header of the answer: zero, or the error with a minus.
    let error = answer.get(16..20).filter(|_| length >= 20);
    match error.and_then(|bytes| bytes.try_into().ok()).map(i32::from_ne_bytes) {
        Some(0) => Ok(()),
        Some(error) => Err(io::Error::from_raw_os_error(-error)),
        None => Err(io::Error::other("no answer")),
    }
}

fn open(index: u32) -> io::Result<File> {
    let can = socket(libc::AF_CAN, libc::CAN_RAW)?;
    // SAFETY: all zero is a valid address.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::AF_CAN as u16;
    address.can_ifindex = index as i32;
    let patience = libc::timeval { tv_sec: 2, tv_usec: 0 };
    // SAFETY: both structures are live and have the lengths that are told.
    let result = unsafe {
        let length = size_of::<libc::timeval>() as u32;
        libc::setsockopt(
            can.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_RCVTIMEO,
            (&raw const patience).cast(),
            length,
        ) | libc::bind(
            can.as_raw_fd(),
            (&raw const address).cast(),
            size_of::<libc::sockaddr_can>() as u32,
        )
    };
    if result == 0 { Ok(can) } else { Err(io::Error::last_os_error()) }
}

fn run() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1).ok_or("which interface?")?;
    let c_name = CString::new(name.as_str())?;
    // SAFETY: reads a string that ends with a NUL.
    let index = unsafe { libc::if_nametoindex(c_name.as_ptr()) };
    if index == 0 {
        return Err(format!("{name}: {}", io::Error::last_os_error()).into());
    }
    set_up(index)?;
    let mut can = open(index)?;
    println!("{name} is up");
    let (mut echoed, mut lost, mut disordered, mut last) = (0_u64, 0, 0, 0);
    let mut frame = [0; FRAME];
    loop {
        match can.read(&mut frame) {
            Ok(FRAME) => {
                can.write_all(&frame)?;
                echoed += 1;
                let [.., a, b, c, d, e, f, g, h] = frame;
                let number = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
                match number.checked_sub(last) {
                    None | Some(0) => disordered += 1,
                    Some(step) => {
                        lost += step - 1;
                        last = number;
                    }
                }
            }
            Ok(length) => return Err(format!("a frame of {length} bytes").into()),
            Err(e) if e.kind() == ErrorKind::WouldBlock && echoed == 0 => {}
            Err(e) if e.kind() == ErrorKind::WouldBlock => break,
            Err(e) => return Err(e.into()),
        }
    }
    println!("host: echoed {echoed}, lost {lost}, disordered {disordered}, last {last}");
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("can-echo: {error}");
            ExitCode::FAILURE
        }
    }
}
