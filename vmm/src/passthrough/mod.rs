//! Devices of the host in the hands of a PLC.
//!
//! A PLC without outputs controls nothing, and a device model between it and its outputs would be
//! one more thing to trust and to wait for. So the partition file gives ports and memory of real
//! devices to a partition, and Takt stays out of the way as far as the processor lets it: memory
//! is mapped into the guest and costs no exit; an access to a port is an exit, and the partition's
//! own thread makes the same access on the host.
//!
//! [`vfio`] gives the memory of a function and its DMA as well, confined by an I/O memory management
//! unit. It does not know the ports of a board that is no PCI function, and it needs that unit: so it
//! is for those functions of which the file says it.
//!
//! All that can fail is done before a partition starts, by [`Devices::take`]; what is left for the
//! guest's thread are loads, stores, `in` and `out`.

mod bound;
pub mod command;
pub mod emergency_stop;
pub mod error;
pub mod guardian;
pub mod mapping;
pub mod pci;
pub mod ports;
pub mod real_ports;
pub mod resources;
pub mod safe_values;
mod source;
pub mod uio;
pub mod vfio;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use kvm_ioctls::VmFd;
use takt_scheduler::table::PartitionId;

use crate::appliance::Role;
use crate::config::{
    Bar, DeviceMemory, Interrupt, InterruptSource, MemorySource, Partition, PartitionFile,
    Passthrough, PciFunction, PortIo, SafePlace,
};
use crate::interrupts::line::Line;
use crate::memory::MemoryError;
use crate::sandbox::Mode;
use crate::terminal::tell;
use crate::vcpu::Control;
use crate::vcpu::port_access::Width;
use emergency_stop::Armed;
use error::DeviceError;
use guardian::Guardian;
use mapping::Mapping;
use pci::{Function, Terms};
use ports::{PortMap, PortRange};
use real_ports::RealPorts;
use safe_values::{SafeValues, Target, Write};
use vfio::Space;

const PCI_DEVICES: &str = "/sys/bus/pci/devices";

/// The devices of all partitions. Dropping it gives them back to the host, so it has to outlive
/// the guests.
pub struct Devices {
    /// By partition. Before `functions`: mappings go before what they are of.
    granted: Vec<Granted>,
    functions: Vec<Function>,
}

/// What one partition has been given.
#[derive(Clone, Debug)]
pub struct Granted {
    /// Its ports.
    pub ports: PortMap<RealPorts>,
    /// What is written when it ends.
    pub safe_values: SafeValues,
    /// Guest-physical addresses, and what is there.
    pub memory: Vec<(u64, Arc<Mapping>)>,
    /// Vectors, and on which lines they come.
    pub lines: Vec<(u8, Arc<Line>)>,
    /// Functions that may master the bus, and what they reach.
    pub space: Option<Arc<Space>>,
}

impl Granted {
    /// Whether there are interrupts among it.
    #[must_use]
    pub fn interrupts(&self) -> bool {
        !self.lines.is_empty()
    }

    /// Lets the guest of `vm` use the memory. `self` must be kept for as long as that guest.
    ///
    /// # Errors
    /// [`MemoryError::Slot`].
    pub fn map_into(&self, vm: &VmFd) -> Result<(), MemoryError> {
        let mut all = (0..).zip(&self.memory);
        all.try_for_each(|(index, (address, memory))| memory.map_into(vm, index, *address))
    }
}

impl Devices {
    /// Takes from the host what the file gives to partitions, and says what that meant for PCI
    /// functions.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn take(file: &PartitionFile, role: Role) -> Result<Self, DeviceError> {
        let (mut functions, mut spaces) = (Vec::new(), Vec::new());
        for partition in file.partitions() {
            spaces.push(take_functions(partition, &mut functions, role)?.map(Arc::new));
        }
        let mut found = Found::default();
        let partitions = file.partitions().iter().zip(spaces);
        let granted = partitions.map(|(p, space)| found.grant(p, &functions, space));
        Ok(Self { granted: granted.collect::<Result<_, _>>()?, functions })
    }

    /// What a partition has been given; `None` for one of another file.
    #[must_use]
    pub fn of(&self, partition: PartitionId) -> Option<&Granted> {
        self.granted.get(partition.0)
    }

    /// Makes a panic and a forbidden system call end all guests and write the safe values of all
    /// partitions, for as long as the guard lives. The partitions' threads are those of `threads`, in
    /// their order.
    #[must_use]
    pub fn guard(&self, threads: &[Arc<Control>]) -> Armed {
        Armed::new(self.safe_values().into_iter().zip(threads.iter().cloned()))
    }

    /// Makes the end of this process write the safe values of all partitions, whatever it dies of,
    /// until the guardian is dropped. `None` if there are no values.
    ///
    /// # Errors
    /// [`DeviceError::Guardian`].
    pub fn guardian(&self, mode: Mode) -> Result<Option<Guardian>, DeviceError> {
        Guardian::start(&self.safe_values(), mode).map_err(DeviceError::Guardian)
    }

    fn safe_values(&self) -> Vec<SafeValues> {
        self.granted.iter().map(|granted| granted.safe_values.clone()).collect()
    }

    /// Folders in which something is written when the devices are given back.
    #[must_use]
    pub fn folders(&self) -> Vec<PathBuf> {
        self.functions.iter().flat_map(Function::folders).collect()
    }
}

/// Takes the functions of a partition; the space is that of those which may master the bus.
fn take_functions(
    partition: &Partition,
    functions: &mut Vec<Function>,
    role: Role,
) -> Result<Option<Space>, DeviceError> {
    let devices = Path::new(PCI_DEVICES);
    let Passthrough { ports, memory, interrupts, .. } = partition.passthrough();
    let of_memory = memory.iter().filter_map(|memory| match &memory.source {
        MemorySource::Pci(bar) => Some(bar),
        _ => None,
    });
    let bars: Vec<&Bar> = ports.iter().filter_map(|p| p.bar.as_ref()).chain(of_memory).collect();
    let confined: Vec<&str> =
        bars.iter().filter(|bar| bar.vfio).map(|bar| bar.function.name()).collect();
    // Of a group all have to be bound before one can be opened.
    let mut groups = Vec::new();
    for bar in &bars {
        let name = bar.function.name();
        if functions.iter().any(|function| function.name() == name) {
            continue;
        }
        // A function has one driver and one bit, however many of its registers are named.
        let same = || bars.iter().filter(|other| other.function == bar.function);
        let terms = Terms {
            role,
            unbind: same().any(|bar| bar.unbind),
            trusted_dma: same().any(|bar| bar.trusted_dma),
            vfio: same().any(|bar| bar.vfio),
            interrupt: interrupts.iter().any(|i| i.source.is_of(&bar.function)),
        };
        if terms.vfio {
            let group = vfio::group::of(devices, name, &confined)?;
            groups.push((functions.len(), group, terms.interrupt));
        }
        let function = Function::take(devices, name, terms)?;
        let driver = function
            .driver()
            .map_or(String::new(), |driver| format!("taken from the host's driver {driver}, "));
        let master = if terms.trusted_dma {
            "it may master the bus and so reach all memory of this machine"
        } else if terms.vfio {
            "it may master the bus and reaches the memory of its partition"
        } else {
            "bus mastering is off"
        };
        tell(format_args!("takt: {name} for {}: {driver}{master}", partition.name()));
        functions.push(function);
    }
    if groups.is_empty() {
        return Ok(None);
    }
    let devices = Path::new("/dev");
    let mut space = Space::open(devices)?;
    for (index, group, interrupt) in groups {
        if let Some(function) = functions.get_mut(index) {
            function.confine(&mut space, devices, group, interrupt)?;
        }
    }
    Ok(Some(space))
}

/// Where things were found on the host: a name for what, whose it is, and from where to where.
#[derive(Default)]
struct Found {
    ports: Vec<(String, String, [u64; 2])>,
    memory: Vec<(String, String, [u64; 2])>,
}

impl Found {
    fn grant(
        &mut self,
        partition: &Partition,
        functions: &[Function],
        space: Option<Arc<Space>>,
    ) -> Result<Granted, DeviceError> {
        let Passthrough { ports, memory, safe_values, interrupts } = partition.passthrough();
        let mut ranges = Vec::with_capacity(ports.len());
        for port_io in ports {
            let range = range_of(port_io, functions)?;
            let name = format!("the range of ports {:#x} to {:#x}", range.first, range.last);
            let place = [range.host.into(), range.host_last().into()];
            apart(&mut self.ports, name, partition.name(), place)?;
            ranges.push(range);
        }
        let mut mappings = Vec::with_capacity(memory.len());
        for entry in memory {
            let (mapping, start) = map(entry, functions)?;
            let place = [start, start.saturating_add(entry.bytes - 1)];
            apart(&mut self.memory, format!("the mmio {}", entry.name), partition.name(), place)?;
            mappings.push((entry.address, Arc::new(mapping)));
        }
        let writes = safe_values.iter().filter_map(|safe| {
            let width = Width::of(safe.width)?;
            let target = match safe.place {
                SafePlace::Port(port) => {
                    Target::Port(ranges.iter().find_map(|range| range.translate(port, width))?)
                }
                SafePlace::Register { memory, offset } => {
                    Target::Register(mappings.get(memory)?.1.clone(), offset)
                }
            };
            Some(Write { target, width, value: safe.value })
        });
        let safe_values = SafeValues::new(writes.collect());
        let lines = interrupts.iter().map(|i| Ok((i.vector, Arc::new(line(i, functions)?))));
        let lines = lines.collect::<Result<_, DeviceError>>()?;
        Ok(Granted {
            ports: PortMap::new(&ranges, RealPorts),
            safe_values,
            memory: mappings,
            lines,
            space,
        })
    }
}

/// The same ports behind two names would belong to two partitions.
fn apart(
    found: &mut Vec<(String, String, [u64; 2])>,
    device: String,
    partition: &str,
    place: [u64; 2],
) -> Result<(), DeviceError> {
    let meets =
        |(_, _, other): &&(String, String, [u64; 2])| place[0] <= other[1] && other[0] <= place[1];
    if let Some((other_device, other, _)) = found.iter().find(meets) {
        return Err(DeviceError::Meet {
            device,
            partition: partition.to_owned(),
            other_device: other_device.clone(),
            other: other.clone(),
        });
    }
    found.push((device, partition.to_owned(), place));
    Ok(())
}

fn function<'a>(
    wanted: &PciFunction,
    functions: &'a [Function],
) -> Result<&'a Function, DeviceError> {
    let name = wanted.name();
    functions
        .iter()
        .find(|function| function.name() == name)
        .ok_or_else(|| DeviceError::Unexpected(Path::new(PCI_DEVICES).join(name)))
}

fn range_of(port_io: &PortIo, functions: &[Function]) -> Result<PortRange, DeviceError> {
    let PortIo { first, last, .. } = *port_io;
    let Some(bar) = &port_io.bar else {
        if !port_io.shared_with_host {
            resources::check_ports(first.into(), last.into())?;
        }
        return Ok(PortRange { first, last, host: first });
    };
    let function = function(&bar.function, functions)?;
    let (name, bar) = (function.name(), bar.bar);
    let kind = || DeviceError::BarKind { function: name.to_owned(), bar, wanted: "I/O ports" };
    let resource = function.resource(bar)?.filter(|r| r.is_ports()).ok_or_else(kind)?;
    let wanted = u64::from(last - first) + 1;
    if wanted > resource.length {
        let device = format!("register {bar} of {name}");
        return Err(DeviceError::TooShort { device, has: resource.length, wanted, unit: "ports" });
    }
    let end = resource.start.saturating_add(wanted - 1);
    match (u16::try_from(resource.start), u16::try_from(end)) {
        (Ok(host), Ok(_)) => Ok(PortRange { first, last, host }),
        _ => Err(kind()),
    }
}

fn map(entry: &DeviceMemory, functions: &[Function]) -> Result<(Mapping, u64), DeviceError> {
    match &entry.source {
        MemorySource::Pci(bar) => {
            source::map_bar(function(&bar.function, functions)?, bar.bar, entry.bytes)
        }
        MemorySource::Uio { device, map } => source::map_uio(device, *map, entry.bytes),
        MemorySource::Physical { address, shared_with_host } => {
            Ok((source::map_physical(*address, entry.bytes, *shared_with_host)?, *address))
        }
    }
}

fn line(interrupt: &Interrupt, functions: &[Function]) -> Result<Line, DeviceError> {
    match &interrupt.source {
        InterruptSource::Pci(wanted) => function(wanted, functions)?.line(Path::new("/dev")),
        InterruptSource::Uio(device) => uio::line_of(device),
    }
}
