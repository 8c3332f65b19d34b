//! Why a device of the host's cannot be given to a partition.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::memory::MemoryError;

/// A device cannot be passed through. The partition file is right in itself; it is the host that
/// has another device, or none, or needs it.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// There is no second process.
    #[error("cannot start the process that writes safe values if this one dies: {0}")]
    Guardian(io::Error),
    /// There is no such device.
    #[error("there is no device {device}: {}: {source}", path.display())]
    Missing {
        /// As the file names it.
        device: String,
        /// Where it was looked for.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// A driver of the host's uses it.
    #[error(
        "{function} is in use by the host's driver {driver}: write `unbind = true` beside its `pci`, or do `echo {function} > /sys/bus/pci/drivers/{driver}/unbind`"
    )]
    InUse {
        /// The function.
        function: String,
        /// Its driver.
        driver: String,
    },
    /// It belongs to another Takt.
    #[error("{0} is in use by another Takt")]
    Held(String),
    /// The host refused something.
    #[error("cannot {what} {device}: {source}")]
    Host {
        /// What was attempted.
        what: &'static str,
        /// With which device.
        device: String,
        /// What the host said.
        source: io::Error,
    },
    /// Something in sysfs is not as the kernel documents it.
    #[error("{}: not understood", .0.display())]
    Unexpected(PathBuf),
    /// The function would still reach all memory.
    #[error(
        "bus mastering of {0} cannot be switched off: it could write any memory of the host; if it may, write `trusted_dma = true` beside its `pci`"
    )]
    MastersBus(String),
    /// There is no driver for interrupts of PCI functions.
    #[error(
        "the interrupt of {0} needs the host's driver uio_pci_generic: `modprobe uio_pci_generic`"
    )]
    NoUio(String),
    /// There is no VFIO.
    #[error("{0} with `vfio` needs the host's driver vfio-pci: `modprobe vfio-pci`")]
    NoVfio(String),
    /// VFIO without its part for this kind of address spaces.
    #[error("`vfio` needs the host's vfio_iommu_type1: `modprobe vfio_iommu_type1`")]
    NoType1,
    /// It would reach all memory.
    #[error(
        "{0} is behind no IOMMU: switch VT-d or AMD-Vi on in the firmware, and add `intel_iommu=on` to the kernel's command line on Intel"
    )]
    NoIommu(String),
    /// Functions only go together.
    #[error(
        "{function} is in IOMMU group {group} with {fellow}, and a group has one address space: give the partition registers of {fellow} with `vfio = true` too"
    )]
    SharedGroup {
        /// The function.
        function: String,
        /// Number of the group.
        group: u32,
        /// Another function.
        fellow: String,
    },
    /// VFIO says so, and not why.
    #[error("{function} is in IOMMU group {group}, of which a driver of the host's has a function")]
    NotViable {
        /// The function.
        function: String,
        /// Number of the group.
        group: u32,
    },
    /// It could write messages that are interrupts of the host.
    #[error(
        "{0} could forge interrupts of the host: its IOMMU does not remap interrupts; switch that on in the firmware"
    )]
    NoRemapping(String),
    /// Memory that devices reach is locked.
    #[error(
        "cannot lock {bytes} bytes of guest memory for a device: run as root, or raise the limit (ulimit -l unlimited)"
    )]
    LockLimit {
        /// Of the region.
        bytes: u64,
    },
    /// The address space has no room for it.
    #[error(
        "no device can be let reach {bytes:#x} bytes of guest memory at {start:#x}: {source}; addresses that firmware keeps are in /sys/kernel/iommu_groups/*/reserved_regions"
    )]
    Reach {
        /// Guest-physical start.
        start: u64,
        /// Of the region.
        bytes: u64,
        /// What the host said.
        source: io::Error,
    },
    /// A UIO driver that cannot open and close the line.
    #[error(
        "the driver of {device} cannot switch its interrupt off: {source}; a PCI function is named by `pci`"
    )]
    NoSwitch {
        /// The UIO device.
        device: String,
        /// What the host said.
        source: io::Error,
    },
    /// The register is not there or of the other kind.
    #[error("register {bar} of {function} has no {wanted}")]
    BarKind {
        /// The function.
        function: String,
        /// The register.
        bar: u8,
        /// "I/O ports" or "memory".
        wanted: &'static str,
    },
    /// There is less of it than the file says.
    #[error("{device} has {has:#x} {unit}, and the partition file asks for {wanted:#x}")]
    TooShort {
        /// What.
        device: String,
        /// Its length.
        has: u64,
        /// What was asked for.
        wanted: u64,
        /// "ports" or "bytes".
        unit: &'static str,
    },
    /// The start of a device's memory shares a page with something else.
    #[error(
        "{device} starts in the middle of a page, at {start:#x}: the guest would get what lies before it too; the kernel's `pci=resource_alignment=` can move it"
    )]
    Unaligned {
        /// What.
        device: String,
        /// Its host-physical start.
        start: u64,
    },
    /// It is memory of the host.
    #[error("the host's addresses {0:#x} to {1:#x} are RAM, not a device")]
    Ram(u64, u64),
    /// The host itself runs on it.
    #[error(
        "among the {what} {first:#x} to {last:#x} is {owner} of the host ({list}): choose others, or write `shared_with_host = true` beside them if the partition may stop the host"
    )]
    Own {
        /// Ports or addresses.
        what: &'static str,
        /// The first.
        first: u64,
        /// The last.
        last: u64,
        /// What the kernel calls it.
        owner: String,
        /// Where the kernel says so.
        list: &'static str,
    },
    /// What was found on the host overlaps.
    #[error("{device} of {partition} and {other_device} of {other} meet on this host")]
    Meet {
        /// What.
        device: String,
        /// Whose.
        partition: String,
        /// What else.
        other_device: String,
        /// Whose.
        other: String,
    },
    /// The guest cannot be given it.
    #[error(transparent)]
    Memory(#[from] MemoryError),
}
