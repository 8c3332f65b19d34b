//! The PCI function of a Linux guest with ports: where its memory lies, and what is in it.
//!
//! Memory has to be there before the machine is made, and the machine before it can be connected,
//! so there are two steps: [`Pci::new`] chooses addresses, [`PciPortDevice::attach`] fills and connects. A
//! Linux without ports takes neither and has no PCI at all. The second step is taken at each start.

use kvm_ioctls::VmFd;
use takt_abi::PortTable;
use takt_abi::memory::PAGE;
use takt_devices::pci::bar::WindowFull;
use takt_devices::pci::config_ports::{self, ConfigPorts};
use takt_devices::pci::function::{Bars, Function};
use takt_devices::ports::{Overlap, PortBus};
use takt_plan::linux_map::PCI_WINDOW;
use takt_scheduler::time::TscFrequency;
use thiserror::Error;
use vmm_sys_util::eventfd::EventFd;

use crate::channels::{ChannelError, OwnRegion, Ports};
use crate::doorbell;
use crate::machine::MachineError;
use crate::memory::{GuestMemory, MemoryError, SharedRegion, View};

/// The function could not be made.
#[derive(Debug, Error)]
pub enum PciError {
    /// It has more memory than there is room for.
    #[error(transparent)]
    Window(#[from] WindowFull),
    /// There is no memory for the page of its table.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// A channel could not be written into its memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// Another device has its ports.
    #[error("two devices of the Linux machine collide: {0}")]
    Ports(#[from] Overlap),
    /// KVM refuses.
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// A function that is laid out.
pub struct Pci<'a> {
    bars: Bars,
    ports: Ports<'a>,
    table: SharedRegion,
}

impl<'a> Pci<'a> {
    /// Lays out the function for these ports; `None` if there are none.
    ///
    /// # Errors
    /// If there is no memory for the page of the table, or no room for the function's memory, of
    /// which a checked file does not ask for so much.
    pub fn new(mut ports: Ports<'a>) -> Result<Option<Self>, PciError> {
        if ports.table.count == 0 {
            return Ok(None);
        }
        let bars = Bars::assign(&PCI_WINDOW, PAGE + ports.bytes(false), ports.bytes(true))?;
        ports.place(bars.read_write.address().into(), bars.read_only.address().into());
        Ok(Some(Self { bars, ports, table: SharedRegion::new(PAGE)? }))
    }

    /// What the guest sees: its port table, and the regions of its channels. What is left of the
    /// function's memory, which is a power of two, stays empty.
    #[must_use]
    pub fn views(&self) -> Vec<View<'_>> {
        let start = self.bars.read_only.address().into();
        let table = View { start, region: &self.table, writable: false };
        std::iter::once(table).chain(self.ports.views.iter().copied()).collect()
    }

    /// What is left to do once there is memory, made of [these views](Self::views).
    #[must_use]
    pub fn into_card(self) -> PciPortDevice {
        PciPortDevice { bars: self.bars, table: self.ports.table, own: self.ports.own }
    }
}

/// A function whose memory is there.
pub struct PciPortDevice {
    bars: Bars,
    table: PortTable,
    own: Vec<OwnRegion>,
}

impl PciPortDevice {
    /// Fills the guest's `memory` and connects the function: configuration to the guest's I/O
    /// ports, the interrupt to `bell`. Once for each machine that the guest gets.
    ///
    /// # Errors
    /// See [`PciError`].
    pub fn attach(
        &self,
        memory: &GuestMemory,
        tsc: TscFrequency,
        vm: &VmFd,
        bus: &mut PortBus,
        bell: &EventFd,
    ) -> Result<(), PciError> {
        let mut table = memory
            .port_table(self.bars.read_only.address().into())
            .ok_or(MachineError::Missing("the Linux guest's port table"))?;
        table.write(PortTable { tsc_khz: tsc.khz().into(), ..self.table });
        for region in &self.own {
            region.format(memory)?;
        }
        let function = ConfigPorts::new(Function::new(self.bars.clone()));
        bus.attach(config_ports::FIRST..=config_ports::LAST, Box::new(function))?;
        Ok(doorbell::attach_listener(vm, bell)?)
    }
}
