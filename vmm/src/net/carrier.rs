//! What moves the packets of an interface: the kernel's vhost-net, on a tap device.

use std::io;
use std::os::fd::AsRawFd;

use takt_devices::net::Agreed;
use takt_devices::virtio::carried::{Carrier, QUEUES, Ring};
use vhost::vhost_kern::vhost_binding::{VHOST_NET_SET_BACKEND, vhost_vring_file};
use vmm_sys_util::ioctl::ioctl_with_ref;

use super::tap::Tap;
use crate::vhost::{Model, Vhost};

/// The kernel's device.
pub const MODEL: Model = Model { path: "/dev/vhost-net", module: "vhost_net" };

/// Both.
pub struct VhostNet {
    pub vhost: Vhost,
    pub tap: Tap,
}

impl VhostNet {
    fn hand_over(&self, agreed: u64, rings: &[Ring; QUEUES]) -> io::Result<()> {
        self.tap.set_offloads(&Agreed::of(agreed))?;
        self.vhost.set_rings(agreed, rings).map_err(io::Error::other)?;
        (0..QUEUES).try_for_each(|queue| self.set_backend(queue, Some(&self.tap)))
    }

    /// Lets a queue's packets come from and go to a file, or from and to none.
    fn set_backend(&self, queue: usize, tap: Option<&Tap>) -> io::Result<()> {
        let fd = tap.map_or(-1, |tap| tap.as_raw_fd());
        let backend = vhost_vring_file { index: queue as u32, fd };
        // SAFETY: the kernel reads the live structure.
        let result = unsafe { ioctl_with_ref(&self.vhost, VHOST_NET_SET_BACKEND(), &backend) };
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }
}

impl Carrier for VhostNet {
    fn features(&self) -> u64 {
        self.vhost.features()
    }

    fn start(&mut self, agreed: u64, rings: [Ring; QUEUES]) -> io::Result<()> {
        self.hand_over(agreed, &rings).inspect_err(|_| self.stop())
    }

    fn stop(&mut self) {
        for queue in 0..QUEUES {
            // Fails only if the device has no owner any more, and then it has no queues.
            let _ = self.set_backend(queue, None);
        }
    }
}
