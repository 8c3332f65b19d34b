//! The kernel's vhost-net, by the crate `vhost`.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::Arc;

use takt_devices::net::{Agreed, Carrier, QUEUE_SIZE, QUEUES, Ring};
use vhost::vhost_kern::VhostKernBackend;
use vhost::vhost_kern::vhost_binding::{VHOST_NET_SET_BACKEND, vhost_vring_file};
use vhost::{VhostBackend, VhostUserMemoryRegionInfo, VringConfigData};
use vm_memory::{GuestMemoryBackend, GuestMemoryMmap, GuestMemoryRegion};
use vmm_sys_util::eventfd::EventFd;
use vmm_sys_util::ioctl::ioctl_with_ref;

use super::NetError;
use super::tap::Tap;

const DEVICE: &str = "/dev/vhost-net";
/// `VIRTIO_F_VERSION_1`.
const VERSION_1: u64 = 1 << 32;

/// An open vhost-net. All calls to it are thread-safe.
pub struct Vhost {
    file: File,
    /// The guest's RAM, which rings are in.
    memory: Arc<GuestMemoryMmap>,
    features: u64,
}

impl Vhost {
    /// Opens the device, for a guest with this RAM. It belongs to no process yet.
    ///
    /// # Errors
    /// See [`NetError`].
    pub fn open(memory: GuestMemoryMmap) -> Result<Self, NetError> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(DEVICE)
            .map_err(|source| NetError::Device { path: DEVICE, module: "vhost_net", source })?;
        let mut vhost = Self { file, memory: Arc::new(memory), features: 0 };
        vhost.features = vhost.get_features().map_err(cannot("tell its features"))?;
        if vhost.features & VERSION_1 == 0 {
            return Err(NetError::Old);
        }
        Ok(vhost)
    }

    /// Tells it, once it has an owner, all that does not change: the guest's memory, and what rings.
    ///
    /// # Errors
    /// See [`NetError`].
    pub fn prepare(&self, bells: &[EventFd], interrupt: &EventFd) -> Result<(), NetError> {
        let region = |region: &vm_memory::GuestRegionMmap| VhostUserMemoryRegionInfo {
            guest_phys_addr: region.start_addr().0,
            memory_size: region.len(),
            userspace_addr: region.as_ptr() as u64,
            ..Default::default()
        };
        let regions: Vec<_> = self.memory.iter().map(region).collect();
        self.set_mem_table(&regions).map_err(cannot("take the guest's memory"))?;
        for (queue, bell) in bells.iter().enumerate() {
            self.set_vring_kick(queue, bell).map_err(cannot("take a doorbell"))?;
            self.set_vring_call(queue, interrupt).map_err(cannot("take an interrupt"))?;
        }
        Ok(())
    }

    /// Ends its thread. The guest gets and sends nothing any more.
    pub fn end(&self) {
        // Fails only if there is no owner, and then there is no thread.
        let _ = self.reset_owner();
    }

    /// Lets a queue's packets come from and go to a file, or from and to none.
    fn set_backend(&self, queue: usize, tap: Option<&Tap>) -> io::Result<()> {
        let fd = tap.map_or(-1, |tap| tap.file().as_raw_fd());
        let backend = vhost_vring_file { index: queue as u32, fd };
        // SAFETY: the kernel reads the live structure.
        let result = unsafe { ioctl_with_ref(self, VHOST_NET_SET_BACKEND(), &backend) };
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    fn set_ring(&self, queue: usize, ring: &Ring) -> vhost::Result<()> {
        self.set_vring_num(queue, ring.size())?;
        self.set_vring_base(queue, 0)?;
        let addresses = VringConfigData {
            queue_max_size: QUEUE_SIZE,
            queue_size: ring.size(),
            desc_table_addr: ring.descriptors(),
            avail_ring_addr: ring.available(),
            used_ring_addr: ring.used(),
            ..Default::default()
        };
        self.set_vring_addr(queue, &addresses)
    }
}

impl AsRawFd for Vhost {
    fn as_raw_fd(&self) -> RawFd {
        self.file.as_raw_fd()
    }
}

impl VhostKernBackend for Vhost {
    type AS = Arc<GuestMemoryMmap>;

    fn mem(&self) -> &Self::AS {
        &self.memory
    }

    /// The crate's own check looks at the byte behind each part, which refuses one at the end of RAM, and not
    /// at those between. A [`Ring`] has been checked whole when it was made, against the same memory.
    fn is_valid(&self, _: &VringConfigData) -> bool {
        true
    }
}

/// What moves the packets of an interface.
pub(super) struct VhostNet {
    pub vhost: Arc<Vhost>,
    pub tap: Tap,
}

impl VhostNet {
    fn hand_over(&self, agreed: Agreed, rings: &[Ring; QUEUES]) -> io::Result<()> {
        self.tap.set_offloads(&agreed)?;
        let vhost = &self.vhost;
        // The others are for the two ends of the cable, not for what lies between.
        vhost.set_features(agreed.features & vhost.features).map_err(io::Error::other)?;
        for (queue, ring) in rings.iter().enumerate() {
            vhost.set_ring(queue, ring).map_err(io::Error::other)?;
        }
        (0..QUEUES).try_for_each(|queue| vhost.set_backend(queue, Some(&self.tap)))
    }
}

impl Carrier for VhostNet {
    fn features(&self) -> u64 {
        self.vhost.features
    }

    fn start(&mut self, agreed: Agreed, rings: [Ring; QUEUES]) -> io::Result<()> {
        self.hand_over(agreed, &rings).inspect_err(|_| self.stop())
    }

    fn stop(&mut self) {
        for queue in 0..QUEUES {
            // Fails only if the device has no owner any more, and then it has no queues.
            let _ = self.vhost.set_backend(queue, None);
        }
    }
}

fn cannot(what: &'static str) -> impl FnOnce(vhost::Error) -> NetError {
    move |source| NetError::Vhost { what, source }
}
