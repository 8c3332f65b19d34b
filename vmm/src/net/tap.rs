//! The host's end of an interface: a tap device.
//!
//! One that is there is taken as it is. One that is not is made, switched on, and given what the partition
//! file says. It is gone when its last descriptor is closed, so also when Takt is killed: there is nothing to
//! remove.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::mem;
use std::net::Ipv4Addr;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use takt_devices::net::Agreed;
use takt_plan::{HostEnd, Net};
use vmm_sys_util::ioctl::{ioctl_with_mut_ref, ioctl_with_ref, ioctl_with_val};

use super::NetError;
use crate::vhost::VhostError;

const DEVICE: &str = "/dev/net/tun";
/// Bytes before each packet: `struct virtio_net_hdr_v1` of virtio 1.
const HEADER: libc::c_int = 12;

/// Calls and flags of `include/uapi/linux/if_tun.h` and `sockios.h` that the C library has no name for.
mod call {
    vmm_sys_util::ioctl_iow_nr!(TUNSETIFF, b'T' as u32, 202, libc::c_int);
    vmm_sys_util::ioctl_iow_nr!(TUNSETOFFLOAD, b'T' as u32, 208, libc::c_uint);
    vmm_sys_util::ioctl_iow_nr!(TUNSETVNETHDRSZ, b'T' as u32, 216, libc::c_int);
    pub const SIOCBRADDIF: libc::c_ulong = 0x89a2;
    pub const CHECKSUM: u64 = 1;
    /// IPv4, IPv6, and congestion notification.
    pub const SEGMENTS: [u64; 3] = [2, 4, 8];
}

/// An open tap device.
pub struct Tap(File);

impl Tap {
    /// Opens a device, or makes it.
    ///
    /// # Errors
    /// See [`NetError`].
    pub fn open(net: &Net) -> Result<Self, NetError> {
        let is_there = Path::new("/sys/class/net").join(&net.tap).exists();
        let key = match net.host {
            HostEnd::Plain => None,
            HostEnd::Address(..) => Some("address"),
            HostEnd::Bridge(_) => Some("bridge"),
        };
        if let Some(key) = key.filter(|_| is_there) {
            return Err(NetError::Exists { tap: net.tap.clone(), key });
        }
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(DEVICE)
            .map_err(|source| VhostError::Device { path: DEVICE, module: "tun", source })?;
        attach(&file, &net.tap)
            .map_err(|source| NetError::Attach { tap: net.tap.clone(), source })?;
        if !is_there {
            set_up(net)?;
        }
        Ok(Self(file))
    }

    /// Lets the host leave to the guest what it has agreed to.
    ///
    /// # Errors
    /// What the host says.
    pub fn set_offloads(&self, agreed: &Agreed) -> io::Result<()> {
        let segments = call::SEGMENTS.iter().zip(agreed.segments);
        let segments = segments.fold(0, |all, (bit, takes)| if takes { all | bit } else { all });
        let flags = segments | if agreed.checksum { call::CHECKSUM } else { 0 };
        // SAFETY: the argument is a number.
        check(unsafe { ioctl_with_val(&self.0, call::TUNSETOFFLOAD(), flags as libc::c_ulong) })
    }
}

fn attach(file: &File, name: &str) -> io::Result<()> {
    let mut request = request(name);
    request.ifr_ifru.ifru_flags =
        (libc::IFF_TAP | libc::IFF_NO_PI | libc::IFF_VNET_HDR) as libc::c_short;
    // SAFETY: the kernel reads and writes the live structure, whatever the number says of its length.
    check(unsafe { ioctl_with_mut_ref(file, call::TUNSETIFF(), &mut request) })?;
    // SAFETY: the kernel reads the live number.
    check(unsafe { ioctl_with_ref(file, call::TUNSETVNETHDRSZ(), &HEADER) })
}

/// Gives a new device what the file says, and switches it on.
fn set_up(net: &Net) -> Result<(), NetError> {
    let step = |what| {
        let tap = net.tap.clone();
        move |source| NetError::SetUp { tap, what, source }
    };
    let socket = control_socket().map_err(step("make a socket to set up"))?;
    match &net.host {
        HostEnd::Plain => {}
        HostEnd::Address(address, bits) => {
            let mask = Ipv4Addr::from_bits(u32::MAX << (32 - u32::from(*bits)));
            for (call, address) in [(libc::SIOCSIFADDR, *address), (libc::SIOCSIFNETMASK, mask)] {
                let mut request = request(&net.tap);
                request.ifr_ifru.ifru_addr = socket_address(address);
                // SAFETY: the kernel reads the live structure.
                check(unsafe { ioctl_with_ref(&socket, call, &request) })
                    .map_err(step("give an address to"))?;
            }
        }
        HostEnd::Bridge(bridge) => {
            let number = index(&socket, &net.tap).map_err(step("find"))?;
            let mut request = request(bridge);
            request.ifr_ifru.ifru_ifindex = number;
            // SAFETY: the kernel reads the live structure.
            check(unsafe { ioctl_with_ref(&socket, call::SIOCBRADDIF, &request) }).map_err(
                |source| NetError::Bridge { tap: net.tap.clone(), bridge: bridge.clone(), source },
            )?;
        }
    }
    let routers = format!("/proc/sys/net/ipv6/conf/{}/accept_ra", net.tap);
    refuse_routers(Path::new(&routers)).map_err(step("switch IPv6 routers off for"))?;
    switch_on(&socket, &net.tap).map_err(step("switch on"))
}

/// The host would take a guest for its way to the network that says so: Linux believes router advertisements on each new device
/// (`accept_ra` in `Documentation/networking/ip-sysctl.rst`).
fn refuse_routers(setting: &Path) -> io::Result<()> {
    match OpenOptions::new().write(true).open(setting).and_then(|mut file| file.write_all(b"0")) {
        // A kernel without IPv6.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        result => result,
    }
}

fn switch_on(socket: &OwnedFd, name: &str) -> io::Result<()> {
    let mut request = request(name);
    // SAFETY: the kernel reads and writes the live structure.
    check(unsafe { ioctl_with_mut_ref(socket, libc::SIOCGIFFLAGS, &mut request) })?;
    // SAFETY: the call before has filled in this member.
    let flags = unsafe { request.ifr_ifru.ifru_flags };
    request.ifr_ifru.ifru_flags = flags | libc::IFF_UP as libc::c_short;
    // SAFETY: the kernel reads the live structure.
    check(unsafe { ioctl_with_ref(socket, libc::SIOCSIFFLAGS, &request) })
}

fn index(socket: &OwnedFd, name: &str) -> io::Result<libc::c_int> {
    let mut request = request(name);
    // SAFETY: the kernel reads and writes the live structure.
    check(unsafe { ioctl_with_mut_ref(socket, libc::SIOCGIFINDEX, &mut request) })?;
    // SAFETY: the call has filled in this member.
    Ok(unsafe { request.ifr_ifru.ifru_ifindex })
}

/// A request about a device. The rule of the partition file for names leaves room for the NUL.
fn request(name: &str) -> libc::ifreq {
    // SAFETY: all zeros are a valid value of this structure of integers and arrays of them.
    let mut request: libc::ifreq = unsafe { mem::zeroed() };
    let room = request.ifr_name.len() - 1;
    for (to, from) in request.ifr_name.iter_mut().zip(name.bytes().take(room)) {
        *to = from as libc::c_char;
    }
    request
}

/// `struct sockaddr_in`, as the structure that stands for all.
fn socket_address(address: Ipv4Addr) -> libc::sockaddr {
    let mut data = [0; 14];
    for (to, from) in data.iter_mut().skip(2).zip(address.octets()) {
        *to = from as libc::c_char;
    }
    libc::sockaddr { sa_family: libc::AF_INET as libc::sa_family_t, sa_data: data }
}

/// What takes requests about devices.
fn control_socket() -> io::Result<OwnedFd> {
    // SAFETY: takes numbers only.
    let fd = unsafe { libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0) };
    check(fd)?;
    // SAFETY: it is new and belongs to no other value.
    Ok(unsafe { OwnedFd::from_raw_fd(fd) })
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

impl AsRawFd for Tap {
    fn as_raw_fd(&self) -> i32 {
        self.0.as_raw_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_where_the_kernel_looks_for_it() {
        let address = socket_address(Ipv4Addr::new(192, 168, 50, 1));
        assert_eq!(address.sa_family, 2);
        assert_eq!(address.sa_data[..6], [0, 0, 192u8 as libc::c_char, 168u8 as _, 50, 1]);
    }

    #[test]
    fn a_host_without_ipv6_has_no_routers_to_refuse() {
        let folder = std::env::temp_dir();
        let setting = folder.join(format!("takt-accept-ra-{}", std::process::id()));
        assert!(refuse_routers(&setting).is_ok() && !setting.exists());
        std::fs::write(&setting, "1\n").unwrap();
        refuse_routers(&setting).unwrap();
        assert_eq!(std::fs::read(&setting).unwrap()[0], b'0');
        std::fs::remove_file(&setting).unwrap();
    }

    #[test]
    fn a_name_is_whole_and_ends_with_a_zero() {
        let name = request("fifteen-letters").ifr_name;
        assert_eq!((name[0] as u8, name[14] as u8, name[15]), (b'f', b's', 0));
        assert_eq!(request("a-name-that-is-too-long").ifr_name[15], 0);
    }
}
