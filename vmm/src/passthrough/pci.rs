//! Taking a PCI function from the host, and giving it back.
//!
//! The host's driver must not use it meanwhile, its decoding of ports and memory has to be on, and
//! above all it must not master the bus: a device that does can read and write all memory of the
//! machine, whatever the memory slots of its partition say, and a guest that programs such a
//! device can too. So the bus-master bit is cleared unless the file declares that it trusts device
//! and guest. The guest cannot set it again: it has no way to the function's configuration space.
//!
//! All of it is done through sysfs (`Documentation/ABI/testing/sysfs-bus-pci` of the kernel), in a
//! folder that is an argument, so that it is tested without devices.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::bound::{self, Bound, HostDriver};
use super::command;
use super::error::DeviceError;
use super::uio;
use super::vfio::Space;
use super::vfio::device::Device;
use crate::appliance::Role;
use crate::interrupts::line::Line;
use crate::outlet::last_line;
use crate::terminal::tell;

/// Kinds of a resource (`include/linux/ioport.h`).
const RESOURCE_PORTS: u64 = 0x100;
const RESOURCE_MEMORY: u64 = 0x200;

/// What the partition file allows with a function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Terms {
    /// What this process is to the appliance, which has drivers to load.
    pub role: Role,
    /// Unbind the host's driver.
    pub unbind: bool,
    /// Leave it able to master the bus.
    pub trusted_dma: bool,
    /// Hand it to VFIO, to master the bus behind an IOMMU.
    pub vfio: bool,
    /// Make its interrupt available.
    pub interrupt: bool,
}

impl Terms {
    /// The driver that it has meanwhile, if it needs one.
    fn host_driver(self) -> Option<HostDriver> {
        match self {
            Self { vfio: true, .. } => Some(HostDriver::Vfio),
            Self { interrupt: true, .. } => Some(HostDriver::Uio),
            _ => None,
        }
    }
}

/// A PCI function that the host has handed over. Dropping it gives it back.
#[derive(Debug)]
pub struct Function {
    name: String,
    folder: PathBuf,
    /// The driver it was taken from.
    driver: Option<PathBuf>,
    /// Whether it has been enabled for us.
    enabled: bool,
    /// The command register as it is given back.
    command: Option<u16>,
    /// The command register while a guest has the function, its interrupt switched off.
    taken: u16,
    /// The driver that it has meanwhile.
    bound: Option<Bound>,
    /// Once it is [confined](Self::confine).
    vfio: Option<Arc<Device>>,
    /// Its folder, locked: it belongs to one process.
    _held: File,
}

/// Where the kernel has put what is behind a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resource {
    /// First port or byte.
    pub start: u64,
    /// How many.
    pub length: u64,
    flags: u64,
}

impl Resource {
    /// Whether it is I/O ports.
    #[must_use]
    pub const fn is_ports(&self) -> bool {
        self.flags & RESOURCE_PORTS != 0
    }

    /// Whether it is memory.
    #[must_use]
    pub const fn is_memory(&self) -> bool {
        self.flags & RESOURCE_MEMORY != 0
    }
}

impl Function {
    /// Takes the function `name` whose folder is in `devices`.
    ///
    /// # Errors
    /// See [`DeviceError`]. What was changed until then is put back.
    pub fn take(devices: &Path, name: &str, terms: Terms) -> Result<Self, DeviceError> {
        let folder = devices.join(name);
        let held = File::open(&folder).map_err(|source| DeviceError::Missing {
            device: name.to_owned(),
            path: folder.clone(),
            source,
        })?;
        // What another Takt has now looks like what one that was cut off has left over.
        held.try_lock().map_err(|_| DeviceError::Held(name.to_owned()))?;
        let mut this = Self {
            name: name.to_owned(),
            folder,
            driver: None,
            enabled: false,
            command: None,
            taken: 0,
            bound: None,
            vfio: None,
            _held: held,
        };
        this.unbind(terms)?;
        let drivers = devices.with_file_name("drivers");
        // `vfio-pci` enables it too.
        if !terms.vfio {
            this.write("enable", "1").map_err(|e| this.cannot("enable", e))?;
            this.enabled = true;
        }
        if let Some(driver) = terms.host_driver() {
            this.bound = Some(Bound::bind(driver, &this.folder, &drivers, name, terms.role)?);
        }
        if !terms.vfio {
            this.set_command(terms)?;
        }
        Ok(this)
    }

    /// Puts it into the address space of its partition, with all registers and, if
    /// asked for, its interrupt. It must have been taken for VFIO, as all of its group; `devices` is
    /// `/dev`.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn confine(
        &mut self,
        space: &mut Space,
        devices: &Path,
        group: u32,
        interrupt: bool,
    ) -> Result<(), DeviceError> {
        self.vfio = Some(space.add(devices, &self.name, group, interrupt)?);
        Ok(())
    }

    /// Where its memory is mapped, if that is VFIO's business.
    #[must_use]
    pub fn confined(&self) -> Option<&Device> {
        self.vfio.as_deref()
    }

    /// The line on which it interrupts, closed; `devices` is `/dev`.
    ///
    /// # Errors
    /// If there is none, or the host refuses.
    pub fn line(&self, devices: &Path) -> Result<Line, DeviceError> {
        if let Some(device) = &self.vfio {
            let cannot = |e| self.cannot("use the interrupt line of", e);
            let opener = device.opener().map_err(cannot)?;
            return Ok(Line::Vfio { device: device.clone(), opener });
        }
        let bound = self.bound.as_ref().ok_or_else(|| DeviceError::NoUio(self.name.clone()))?;
        let config = self.config().map_err(|e| self.cannot("open the configuration of", e))?;
        let armed = self.taken & !command::NO_INTERRUPT;
        Ok(Line::Pci { uio: uio::of_function(bound, &self.name, devices)?, config, armed })
    }

    /// As the file names it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name of the driver it was taken from.
    #[must_use]
    pub fn driver(&self) -> Option<String> {
        let name = self.driver.as_ref()?.file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// Folders in which something is written when it is given back.
    pub fn folders(&self) -> impl Iterator<Item = PathBuf> {
        let bound = self.bound.as_ref().map(Bound::driver);
        [Some(self.folder.as_path()), self.driver.as_deref(), bound]
            .into_iter()
            .flatten()
            .map(Path::to_owned)
    }

    /// The file through which the memory behind a register is mapped.
    #[must_use]
    pub fn resource_file(&self, bar: u8) -> PathBuf {
        self.folder.join(format!("resource{bar}"))
    }

    /// Where the kernel has put what is behind a register; `None` if there is nothing.
    ///
    /// # Errors
    /// If sysfs does not tell.
    pub fn resource(&self, bar: u8) -> Result<Option<Resource>, DeviceError> {
        let path = self.folder.join("resource");
        let text =
            fs::read_to_string(&path).map_err(|e| self.cannot("read the resources of", e))?;
        let unexpected = || DeviceError::Unexpected(path.clone());
        let line = text.lines().nth(bar.into()).ok_or_else(unexpected)?;
        let number = |text: &str| u64::from_str_radix(text.strip_prefix("0x")?, 16).ok();
        let numbers: Vec<u64> =
            line.split(' ').map(number).collect::<Option<_>>().ok_or_else(unexpected)?;
        let &[start, end, flags] = &numbers[..] else { return Err(unexpected()) };
        if flags == 0 {
            return Ok(None);
        }
        let length =
            end.checked_sub(start).and_then(|n| n.checked_add(1)).ok_or_else(unexpected)?;
        Ok(Some(Resource { start, length, flags }))
    }

    fn unbind(&mut self, terms: Terms) -> Result<(), DeviceError> {
        let Ok(driver) = self.folder.join("driver").canonicalize() else { return Ok(()) };
        let name = driver.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let left_over =
            terms.host_driver().is_some_and(|own| own.is_left_over(&name, &self.folder));
        if !terms.unbind && !left_over {
            return Err(DeviceError::InUse { function: self.name.clone(), driver: name });
        }
        let failed = |e| self.cannot("take the host's driver from", e);
        fs::write(driver.join("unbind"), &self.name).map_err(failed)?;
        if left_over {
            self.write(bound::OVERRIDE, "\n").map_err(failed)?;
            let function = &self.name;
            tell(format_args!(
                "takt: {function}: {name} was left over by a run that was cut off; when takt has ended, \
                 `echo 0 > /sys/bus/pci/devices/{function}/enable` until `cat` of that file says 0, and then \
                 `echo {function} > /sys/bus/pci/drivers_probe` give it back to a driver of the host's"
            ));
        } else {
            self.driver = Some(driver);
        }
        Ok(())
    }

    fn set_command(&mut self, terms: Terms) -> Result<(), DeviceError> {
        let config = self.config().map_err(|e| self.cannot("open the configuration of", e))?;
        let failed = |e| self.cannot("set the command register of", e);
        let found = command::read(&config, 0).map_err(failed)?;
        let wanted = found | command::PORTS | command::MEMORY | command::NO_INTERRUPT;
        let wanted = match terms.trusted_dma {
            true => wanted | command::MASTER,
            false => wanted & !command::MASTER,
        };
        command::write(&config, 0, wanted).map_err(failed)?;
        let now = command::read(&config, 0).map_err(failed)?;
        // The guest may have told the device to transfer. A set bit would carry that out after its end.
        let given_back = if terms.trusted_dma { found } else { found & !command::MASTER };
        (self.command, self.taken) = (Some(given_back), wanted);
        if !terms.trusted_dma && now & command::MASTER != 0 {
            return Err(DeviceError::MastersBus(self.name.clone()));
        }
        Ok(())
    }

    fn config(&self) -> io::Result<File> {
        File::options().read(true).write(true).open(self.folder.join("config"))
    }

    fn write(&self, name: &str, text: &str) -> io::Result<()> {
        fs::write(self.folder.join(name), text)
    }

    fn cannot(&self, what: &'static str, source: io::Error) -> DeviceError {
        DeviceError::Host { what, device: self.name.clone(), source }
    }

    fn give_back(&mut self) -> io::Result<()> {
        if let Some(command) = self.command {
            // A device that the guest has left asking for an interrupt must not ask the host, which
            // has no handler for it. A driver of the host's switches it on again
            // (`do_pci_enable_device` in the kernel's drivers/pci/pci.c).
            let quiet = if self.bound.is_some() { command::NO_INTERRUPT } else { 0 };
            command::write(&self.config()?, 0, command | quiet)?;
        }
        // With its file VFIO ends all transfers, and the kernel waits for that file to be closed before
        // it lets go of the function: one that is still in use would be waited for without end.
        if self.vfio.take().is_some_and(|device| Arc::into_inner(device).is_none()) {
            if let Some(bound) = self.bound.take() {
                std::mem::forget(bound);
            }
            return Err(io::ErrorKind::ResourceBusy.into());
        }
        self.bound = None;
        if self.enabled {
            self.write("enable", "0")?;
        }
        let Some(driver) = &self.driver else { return Ok(()) };
        // The driver sets the bus-master bit, and the device would do what the guest has left in it.
        if self.folder.join("reset").exists() {
            self.write("reset", "1")?;
        }
        fs::write(driver.join("bind"), &self.name)
    }
}

impl Drop for Function {
    fn drop(&mut self) {
        if let Err(error) = self.give_back() {
            let text = format!("cannot give {} back to the host: {error}", self.name);
            last_line(&mut io::stderr(), &text);
        }
    }
}

#[cfg(test)]
#[path = "pci_tests.rs"]
mod tests;
