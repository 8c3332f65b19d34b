//! Devices of a Linux whose queues the host's kernel works on (vhost): network interfaces and sockets.
//!
//! ```text
//! write to the register --> KVM: ioeventfd --> vhost's worker --> tap device, or the host's sockets
//!                          KVM: irqfd     <--/
//! ```
//!
//! The device is one of `takt_devices::virtio::carried`. Takt touches no packet: what a guest and its host send each
//! other goes through a thread of the kernel's (`worker`) that reads and writes the guest's memory. Before a run,
//! Takt opens the kernel's device, tells that thread which memory is the guest's, and puts it onto the CPU of the guest. In
//! a run the guest's own thread makes some calls when its driver starts or resets the device, and no thread
//! of Takt's does anything for a packet.

mod closer;
mod error;
mod watch;
mod worker;

use std::fs::{File, OpenOptions};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::Arc;

use ::vhost::vhost_kern::VhostKernBackend;
use ::vhost::{VhostBackend, VhostUserMemoryRegionInfo, VringConfigData};
use kvm_ioctls::VmFd;
use takt_devices::virtio::carried::{CarriedDevice, Link, QUEUE_SIZE, QUEUES, Ring};
use takt_devices::virtio::registers::Registers;
use vm_memory::{GuestMemoryBackend, GuestMemoryMmap, GuestMemoryRegion};
use vmm_sys_util::eventfd::EventFd;

use crate::event::eventfd;
use crate::machine::MachineError;
use crate::memory::GuestMemory;
use crate::vcpu::thread::Place;
use crate::virtio::Slot;

pub use closer::{Closer, PATIENCE};
pub use error::VhostError;
pub use watch::LinkWatch;

/// `VIRTIO_F_VERSION_1`.
const VERSION_1: u64 = 1 << 32;

/// A device of the kernel's.
#[derive(Clone, Copy)]
pub struct Model {
    /// Where it is opened.
    pub path: &'static str,
    /// What makes it.
    pub module: &'static str,
}

/// What is rung for a device.
pub struct Wires {
    /// By the guest, for each queue.
    bells: [EventFd; QUEUES],
    /// For the guest.
    interrupt: EventFd,
}

impl Wires {
    /// Those of a new device.
    ///
    /// # Errors
    /// If there is no descriptor for them.
    pub fn new() -> Result<Self, VhostError> {
        Ok(Self { bells: [eventfd()?, eventfd()?], interrupt: eventfd()? })
    }
}

/// An open device. All calls to it are thread-safe. When it is dropped its worker ends, and only then the memory
/// may go.
pub struct Vhost {
    model: Model,
    file: File,
    /// The guest's RAM, which rings are in.
    memory: Arc<GuestMemoryMmap>,
    features: u64,
}

impl Vhost {
    /// Opens the device, for a guest with this RAM, and puts its worker to where the guest is. `whose` is what messages
    /// call it.
    ///
    /// # Errors
    /// See [`VhostError`].
    pub fn open(
        model: Model,
        whose: &str,
        memory: GuestMemoryMmap,
        place: Place,
        wires: &Wires,
    ) -> Result<Self, VhostError> {
        let Model { path, module } = model;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)
            .map_err(|source| VhostError::Device { path, module, source })?;
        let mut vhost = Self { model, file, memory: Arc::new(memory), features: 0 };
        vhost.features = vhost.get_features().map_err(vhost.cannot("tell its features"))?;
        if vhost.features & VERSION_1 == 0 {
            return Err(VhostError::Old { path });
        }
        worker::place(&vhost, whose, place)?;
        vhost.prepare(wires)?;
        Ok(vhost)
    }

    /// Tells it, once it has an owner, all that does not change: the guest's memory, and what rings.
    fn prepare(&self, wires: &Wires) -> Result<(), VhostError> {
        let region = |region: &vm_memory::GuestRegionMmap| VhostUserMemoryRegionInfo {
            guest_phys_addr: region.start_addr().0,
            memory_size: region.len(),
            userspace_addr: region.as_ptr() as u64,
            ..Default::default()
        };
        let regions: Vec<_> = self.memory.iter().map(region).collect();
        self.set_mem_table(&regions).map_err(self.cannot("take the guest's memory"))?;
        for (queue, bell) in wires.bells.iter().enumerate() {
            self.set_vring_kick(queue, bell).map_err(self.cannot("take a doorbell"))?;
            self.set_vring_call(queue, &wires.interrupt)
                .map_err(self.cannot("take an interrupt"))?;
        }
        Ok(())
    }

    /// What it is able to do.
    pub fn features(&self) -> u64 {
        self.features
    }

    /// Tells it where the rings are, and what the driver has agreed to. It does not work on them yet.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn set_rings(&self, agreed: u64, rings: &[Ring; QUEUES]) -> ::vhost::Result<()> {
        // The others are for the two ends of the cable, not for what lies between.
        self.set_features(agreed & self.features)?;
        for (queue, ring) in rings.iter().enumerate() {
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
            self.set_vring_addr(queue, &addresses)?;
        }
        Ok(())
    }

    fn cannot(&self, what: &'static str) -> impl FnOnce(::vhost::Error) -> VhostError + use<> {
        let path = self.model.path;
        move |source| VhostError::Call { path, what, source }
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

/// A carried device, as the machines know it that its Linux has one after the other.
pub struct Carried {
    slot: Slot,
    wires: Wires,
    link: Arc<Link>,
    /// The device as it is when a machine is switched on.
    device: Box<dyn Fn() -> CarriedDevice + Send>,
}

impl Carried {
    /// The device in this slot.
    pub fn new(
        slot: Slot,
        wires: Wires,
        link: Arc<Link>,
        device: impl Fn() -> CarriedDevice + Send + 'static,
    ) -> Self {
        Self { slot, wires, link, device: Box::new(device) }
    }

    /// Connects the device to a machine that has not run yet.
    ///
    /// # Errors
    /// If KVM refuses.
    pub fn attach(&self, vm: &VmFd, memory: &GuestMemory) -> Result<Registers, MachineError> {
        self.slot.attach(vm, &self.wires.bells, &self.wires.interrupt)?;
        Ok(Registers::new((self.device)(), self.slot.page(memory)?))
    }

    /// Takes the device away from a guest that does not run any more. Afterwards nothing is written to
    /// its memory.
    pub fn reset(&self) {
        self.link.reset();
    }

    /// What is to be ended at the end of the run.
    #[must_use]
    pub fn link(&self) -> Arc<Link> {
        self.link.clone()
    }
}
