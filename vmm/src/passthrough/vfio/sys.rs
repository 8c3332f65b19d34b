//! The calls of VFIO's that Takt makes, by number and structure.
//!
//! All are from the kernel's `include/uapi/linux/vfio.h`, whose names they have. A few constants and
//! five structures are less to look after than a crate of bindings.

use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, RawFd};

use vmm_sys_util::ioctl::{
    ioctl, ioctl_with_mut_ref, ioctl_with_ptr, ioctl_with_ref, ioctl_with_val,
};

/// `_IO(';', 100 + number)`.
const fn call(number: libc::c_ulong) -> libc::c_ulong {
    (b';' as libc::c_ulong) << 8 | (100 + number)
}

const GET_API_VERSION: libc::c_ulong = call(0);
const CHECK_EXTENSION: libc::c_ulong = call(1);
const SET_IOMMU: libc::c_ulong = call(2);
const GROUP_GET_STATUS: libc::c_ulong = call(3);
const GROUP_SET_CONTAINER: libc::c_ulong = call(4);
const GROUP_GET_DEVICE_FD: libc::c_ulong = call(6);
const DEVICE_GET_INFO: libc::c_ulong = call(7);
const DEVICE_GET_REGION_INFO: libc::c_ulong = call(8);
const DEVICE_SET_IRQS: libc::c_ulong = call(10);
const DEVICE_RESET: libc::c_ulong = call(11);
const IOMMU_MAP_DMA: libc::c_ulong = call(13);

const API_VERSION: i32 = 0;
const TYPE1V2_IOMMU: libc::c_ulong = 3;
const GROUP_FLAGS_VIABLE: u32 = 1;
const DEVICE_FLAGS_RESET: u32 = 1;
const REGION_INFO_FLAG_MMAP: u32 = 1 << 2;
const DMA_MAP_FLAG_READ: u32 = 1;
const DMA_MAP_FLAG_WRITE: u32 = 1 << 1;
const IRQ_SET_DATA_NONE: u32 = 1;
const IRQ_SET_DATA_EVENTFD: u32 = 1 << 2;
const IRQ_SET_ACTION_MASK: u32 = 1 << 3;
const IRQ_SET_ACTION_UNMASK: u32 = 1 << 4;
const IRQ_SET_ACTION_TRIGGER: u32 = 1 << 5;
/// `VFIO_PCI_INTX_IRQ_INDEX`.
const INTX: u32 = 0;
/// `VFIO_PCI_CONFIG_REGION_INDEX`.
pub const CONFIG_REGION: u32 = 7;

#[repr(C)]
#[derive(Debug, Default)]
struct GroupStatus {
    argsz: u32,
    flags: u32,
}

#[repr(C)]
#[derive(Debug, Default)]
struct DeviceInfo {
    argsz: u32,
    flags: u32,
    num_regions: u32,
    num_irqs: u32,
}

#[repr(C)]
#[derive(Debug, Default)]
struct RegionInfo {
    argsz: u32,
    flags: u32,
    index: u32,
    cap_offset: u32,
    size: u64,
    offset: u64,
}

#[repr(C)]
#[derive(Debug, Default)]
struct IrqSet {
    argsz: u32,
    flags: u32,
    index: u32,
    start: u32,
    count: u32,
    /// Only with `IRQ_SET_DATA_EVENTFD`.
    eventfd: i32,
}

#[repr(C)]
#[derive(Debug, Default)]
struct DmaMap {
    argsz: u32,
    flags: u32,
    vaddr: u64,
    iova: u64,
    size: u64,
}

/// What is done with the interrupt line of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IrqAction {
    /// Close it.
    Mask,
    /// Open it with each write to this eventfd.
    UnmaskBy(RawFd),
    /// Tell of interrupts by this eventfd; each closes the line.
    Trigger(RawFd),
}

fn length<T>() -> u32 {
    size_of::<T>() as u32
}

fn check(result: libc::c_int) -> io::Result<libc::c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

/// Whether a container is of the kind that this is written for: version 0, with type 1 (version 2).
pub fn is_usable(container: &File) -> bool {
    // SAFETY: neither call has an argument that points anywhere.
    unsafe {
        ioctl(container, GET_API_VERSION) == API_VERSION
            && ioctl_with_val(container, CHECK_EXTENSION, TYPE1V2_IOMMU) == 1
    }
}

/// Whether no function of the group is in the hands of a driver of the host's.
///
/// # Errors
/// What the kernel says.
pub fn is_viable(group: &File) -> io::Result<bool> {
    let mut status = GroupStatus { argsz: length::<GroupStatus>(), flags: 0 };
    // SAFETY: the kernel fills in a structure of the length that it tells.
    check(unsafe { ioctl_with_mut_ref(group, GROUP_GET_STATUS, &mut status) })?;
    Ok(status.flags & GROUP_FLAGS_VIABLE != 0)
}

/// Puts a group into a container.
///
/// # Errors
/// What the kernel says.
pub fn set_container(group: &File, container: &File) -> io::Result<()> {
    let container = container.as_raw_fd();
    // SAFETY: the kernel reads an integer.
    check(unsafe { ioctl_with_ref(group, GROUP_SET_CONTAINER, &container) }).map(drop)
}

/// Gives a container, which has a group, an address space of its own.
///
/// # Errors
/// What the kernel says: `EPERM` where devices could forge interrupts.
pub fn set_iommu(container: &File) -> io::Result<()> {
    // SAFETY: the argument is a number.
    check(unsafe { ioctl_with_val(container, SET_IOMMU, TYPE1V2_IOMMU) }).map(drop)
}

/// Opens a device of a group by its name, a NUL at its end.
///
/// # Errors
/// What the kernel says.
pub fn device(group: &File, name: &std::ffi::CStr) -> io::Result<File> {
    // SAFETY: the kernel reads a string that ends with a NUL.
    let fd =
        check(unsafe { ioctl_with_ptr(group, GROUP_GET_DEVICE_FD, name.as_ptr().cast_mut()) })?;
    // SAFETY: the descriptor is new and has no other owner.
    Ok(unsafe { File::from_raw_fd(fd) })
}

/// Whether a device can be reset.
///
/// # Errors
/// What the kernel says.
pub fn can_reset(device: &File) -> io::Result<bool> {
    let mut info = DeviceInfo { argsz: length::<DeviceInfo>(), ..DeviceInfo::default() };
    // SAFETY: the kernel fills in a structure of the length that it tells.
    check(unsafe { ioctl_with_mut_ref(device, DEVICE_GET_INFO, &mut info) })?;
    Ok(info.flags & DEVICE_FLAGS_RESET != 0)
}

/// Resets a device.
///
/// # Errors
/// What the kernel says.
pub fn reset(device: &File) -> io::Result<()> {
    // SAFETY: the call has no argument.
    check(unsafe { ioctl(device, DEVICE_RESET) }).map(drop)
}

/// Where in a device's file a region is, and whether it can be mapped.
///
/// # Errors
/// What the kernel says.
pub fn region(device: &File, index: u32) -> io::Result<(u64, bool)> {
    let argsz = length::<RegionInfo>();
    let mut info = RegionInfo { argsz, index, ..RegionInfo::default() };
    // SAFETY: the kernel fills in a structure of the length that it tells.
    check(unsafe { ioctl_with_mut_ref(device, DEVICE_GET_REGION_INFO, &mut info) })?;
    Ok((info.offset, info.size != 0 && info.flags & REGION_INFO_FLAG_MMAP != 0))
}

/// Does something with the interrupt line of a device.
///
/// # Errors
/// What the kernel says: `EINVAL` if it has none.
pub fn interrupt(device: &File, action: IrqAction) -> io::Result<()> {
    let (flags, eventfd) = match action {
        IrqAction::Mask => (IRQ_SET_DATA_NONE | IRQ_SET_ACTION_MASK, None),
        IrqAction::UnmaskBy(fd) => (IRQ_SET_DATA_EVENTFD | IRQ_SET_ACTION_UNMASK, Some(fd)),
        IrqAction::Trigger(fd) => (IRQ_SET_DATA_EVENTFD | IRQ_SET_ACTION_TRIGGER, Some(fd)),
    };
    let without = if eventfd.is_some() { 0 } else { length::<i32>() };
    let set = IrqSet {
        argsz: length::<IrqSet>() - without,
        flags,
        index: INTX,
        start: 0,
        count: 1,
        eventfd: eventfd.unwrap_or(-1),
    };
    // SAFETY: the kernel reads a structure of the length that it tells.
    check(unsafe { ioctl_with_ref(device, DEVICE_SET_IRQS, &set) }).map(drop)
}

/// Lets the devices of a container read and write memory of this process, which is pinned.
///
/// # Errors
/// What the kernel says: `ENOMEM` beyond the limit of locked memory.
pub fn map(container: &File, vaddr: u64, iova: u64, size: u64) -> io::Result<()> {
    let argsz = length::<DmaMap>();
    let map = DmaMap { argsz, flags: DMA_MAP_FLAG_READ | DMA_MAP_FLAG_WRITE, vaddr, iova, size };
    // SAFETY: the kernel reads a structure of the length that it tells. What devices do to the
    // memory is what the guest does: it is accessed by volatile accesses only.
    check(unsafe { ioctl_with_ref(container, IOMMU_MAP_DMA, &map) }).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_lengths_are_those_of_the_kernel() {
        assert_eq!((GET_API_VERSION, IOMMU_MAP_DMA), (0x3b64, 0x3b71));
        assert_eq!((length::<GroupStatus>(), length::<DeviceInfo>()), (8, 16));
        assert_eq!((length::<RegionInfo>(), length::<IrqSet>(), length::<DmaMap>()), (32, 24, 32));
    }

    #[test]
    fn what_is_no_vfio_is_an_error() {
        let file = File::open("/dev/null").unwrap();
        assert!(!is_usable(&file));
        assert!(is_viable(&file).is_err() && set_iommu(&file).is_err());
        assert!(device(&file, c"0000:00:06.0").is_err() && reset(&file).is_err());
        assert!(interrupt(&file, IrqAction::Mask).is_err() && map(&file, 0, 0, 4096).is_err());
    }
}
