//! PCI functions that may master the bus, and reach the memory of their partition and no other.
//!
//! A function that masters the bus reaches all memory of the machine, unless an I/O memory
//! management unit (IOMMU) is in between. VFIO is the kernel's way to program one: a container is
//! an address space, the groups in it are the functions that use it, and what is not mapped there
//! is not reached. Each partition has a container of its own, with its RAM at the addresses at
//! which its guest sees it. Channels, the pages of Takt's and other devices are not in there.
//!
//! - [`group`]: which functions only go together;
//! - [`device`]: what is done with one function;
//! - [`sys`]: the kernel's calls.

pub mod device;
pub mod group;
pub mod sys;

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use vm_memory::{GuestMemoryBackend, GuestMemoryRegion};

use super::error::DeviceError;
use takt_plan::linux_map::{HOLE_END, HOLE_START};

use crate::memory::GuestMemory;
use device::Device;

/// The functions of one partition that may master the bus, and all that they reach.
#[derive(Debug)]
pub struct Space {
    // Before the groups and the container, which they are of.
    devices: Vec<(String, Arc<Device>)>,
    groups: Vec<(u32, File)>,
    container: File,
}

impl Space {
    /// An empty address space; `devices` is `/dev`.
    ///
    /// # Errors
    /// If the host has none to give.
    pub fn open(devices: &Path) -> Result<Self, DeviceError> {
        let path = devices.join("vfio/vfio");
        let container = open(&path)?;
        if !sys::is_usable(&container) {
            return Err(DeviceError::NoType1);
        }
        Ok(Self { devices: Vec::new(), groups: Vec::new(), container })
    }

    /// Adds a function, which is bound to `vfio-pci` as all others of its group are.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn add(
        &mut self,
        devices: &Path,
        name: &str,
        number: u32,
        interrupts: bool,
    ) -> Result<Arc<Device>, DeviceError> {
        if !self.groups.iter().any(|(other, _)| *other == number) {
            let group = open(&devices.join(format!("vfio/{number}")))?;
            self.take(name, number, &group)?;
            self.groups.push((number, group));
        }
        let group = self.groups.iter().find(|(other, _)| *other == number);
        let (_, group) = group.ok_or_else(|| DeviceError::NoIommu(name.to_owned()))?;
        let device = Device::open(group, name, interrupts).map_err(cannot("take by VFIO", name))?;
        let device = Arc::new(device);
        self.devices.push((name.to_owned(), device.clone()));
        Ok(device)
    }

    fn take(&self, name: &str, number: u32, group: &File) -> Result<(), DeviceError> {
        let failed = cannot("take the group by VFIO of", name);
        if !sys::is_viable(group).map_err(failed)? {
            return Err(DeviceError::NotViable { function: name.to_owned(), group: number });
        }
        sys::set_container(group, &self.container).map_err(cannot("confine by the IOMMU", name))?;
        // The first group decides; the others have to fit it.
        if !self.groups.is_empty() {
            return Ok(());
        }
        sys::set_iommu(&self.container).map_err(|source| match source.raw_os_error() {
            Some(libc::EPERM) => DeviceError::NoRemapping(name.to_owned()),
            _ => cannot("confine by the IOMMU", name)(source),
        })
    }

    /// Lets all functions reach the RAM of a guest, and master the bus.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn start(&self, memory: &GuestMemory) -> Result<(), DeviceError> {
        for region in memory.regions().iter() {
            let start = region.start_addr().0;
            if (HOLE_START..HOLE_END).contains(&start) {
                continue;
            }
            let bytes = region.len();
            sys::map(&self.container, region.as_ptr() as u64, start, bytes).map_err(|source| {
                match source.raw_os_error() {
                    Some(libc::ENOMEM) => DeviceError::LockLimit { bytes },
                    _ => DeviceError::Reach { start, bytes, source },
                }
            })?;
        }
        self.resume()
    }

    /// Ends all transfers, and resets what can be reset. To be done while the guest stands.
    ///
    /// # Errors
    /// See [`DeviceError`]. The first one; the other functions are stopped all the same.
    pub fn stop(&self) -> Result<(), DeviceError> {
        let stopped = self.devices.iter().map(|(name, device)| {
            device.let_master(false).map_err(cannot("end the transfers of", name))?;
            device.reset().map_err(cannot("reset", name))
        });
        stopped.fold(Ok(()), Result::and)
    }

    /// Lets all functions master the bus again.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn resume(&self) -> Result<(), DeviceError> {
        self.devices.iter().try_for_each(|(name, device)| {
            device.let_master(true).map_err(cannot("let master the bus:", name))
        })
    }
}

fn open(path: &Path) -> Result<File, DeviceError> {
    let file = File::options().read(true).write(true).open(path);
    file.map_err(|source| DeviceError::Missing {
        device: path.display().to_string(),
        path: path.to_owned(),
        source,
    })
}

fn cannot(what: &'static str, name: &str) -> impl Fn(io::Error) -> DeviceError {
    move |source| DeviceError::Host { what, device: name.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use std::os::fd::FromRawFd;

    use super::super::command;
    use super::*;

    fn file() -> File {
        // SAFETY: the name is a literal; the descriptor is new.
        unsafe { File::from_raw_fd(libc::memfd_create(c"c".as_ptr(), libc::MFD_CLOEXEC)) }
    }

    #[test]
    fn a_function_that_cannot_be_stopped_keeps_no_other_from_being_stopped() {
        let good = file();
        command::write(&good, 0, command::MASTER).unwrap();
        let seen = good.try_clone().unwrap();
        let device = |file| Arc::new(Device::of_file(file, 0, false));
        let devices = [("a", file()), ("b", file()), ("c", good)];
        let devices = devices.map(|(name, file)| (name.to_owned(), device(file))).into();
        let space = Space { devices, groups: Vec::new(), container: file() };
        let error = space.stop().unwrap_err();
        assert!(matches!(&error, DeviceError::Host { device, .. } if device == "a"), "{error}");
        assert_eq!(command::read(&seen, 0).unwrap() & command::MASTER, 0);
    }

    impl Space {
        /// Of this device, without a group; a file is in the place of its container.
        pub fn of_device(device: Device, container: File) -> Self {
            let devices = vec![("card".to_owned(), Arc::new(device))];
            Self { devices, groups: Vec::new(), container }
        }
    }
}
