//! Binding a PCI function to a driver of the kernel's that hands it to a process, by its address, since
//! numbers of devices depend on who came first.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::error::DeviceError;
use crate::appliance::{self, Role};
use crate::terminal::tell;

/// The file of a function that names the only driver which may be bound to it.
pub(super) const OVERRIDE: &str = "driver_override";

/// A driver that knows no function of its own and takes what it is told to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostDriver {
    /// `uio_pci_generic`: interrupts.
    Uio,
    /// `vfio-pci`: everything.
    Vfio,
}

impl HostDriver {
    const fn name(self) -> &'static str {
        match self {
            HostDriver::Uio => "uio_pci_generic",
            HostDriver::Vfio => "vfio-pci",
        }
    }

    /// Whether a function has this driver, `driver`, because a run that was cut off chose it for it.
    pub(super) fn is_left_over(self, driver: &str, function: &Path) -> bool {
        let chosen = || fs::read_to_string(function.join(OVERRIDE)).unwrap_or_default();
        driver == self.name() && chosen().trim_end() == self.name() && !self.is_used(function)
    }

    /// Whether another process has the group of this function open, such as a virtual machine of the host's.
    fn is_used(self, function: &Path) -> bool {
        let group = fs::read_link(function.join("iommu_group")).unwrap_or_default();
        let Some(group) = group.file_name().filter(|_| self == HostDriver::Vfio) else {
            return false;
        };
        let opened =
            File::options().read(true).write(true).open(Path::new("/dev/vfio").join(group));
        opened.is_err_and(|error| error.kind() == io::ErrorKind::ResourceBusy)
    }

    fn load(self, role: Role) -> io::Result<()> {
        match self {
            HostDriver::Uio => appliance::load_for_interrupts(role),
            HostDriver::Vfio => appliance::load_for_vfio(role),
        }
    }

    fn missing(self, function: &str) -> DeviceError {
        match self {
            HostDriver::Uio => DeviceError::NoUio(function.to_owned()),
            HostDriver::Vfio => DeviceError::NoVfio(function.to_owned()),
        }
    }
}

/// A PCI function that is bound to such a driver, until this is dropped.
#[derive(Debug)]
pub struct Bound {
    function: PathBuf,
    driver: PathBuf,
    name: String,
    /// The choice that was made for it before, as its file takes it.
    chosen: String,
}

impl Bound {
    /// Binds the function `name`, of the folder `function`, to a driver in `drivers`.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn bind(
        driver: HostDriver,
        function: &Path,
        drivers: &Path,
        name: &str,
        role: Role,
    ) -> Result<Self, DeviceError> {
        let cannot =
            |what| move |source| DeviceError::Host { what, device: name.to_owned(), source };
        let folder = drivers.join(driver.name());
        if !folder.exists() {
            driver.load(role).map_err(cannot("load the host's driver for"))?;
        }
        if !folder.exists() {
            return Err(driver.missing(name));
        }
        let choice = function.join(OVERRIDE);
        let failed = cannot("choose the host's driver for");
        let chosen = fs::read_to_string(&choice).map_err(&failed)?;
        // The kernel shows this word for no choice, and would take it for the name of a driver.
        let chosen = if chosen.trim_end() == "(null)" { "\n".to_owned() } else { chosen };
        let (function, owned) = (function.to_owned(), name.to_owned());
        let this = Self { function, driver: folder, name: owned, chosen };
        // From here on the drop undoes it.
        fs::write(choice, driver.name()).map_err(&failed)?;
        fs::write(this.driver.join("bind"), name).map_err(cannot("bind the host's driver to"))?;
        Ok(this)
    }

    /// The folder of the function.
    #[must_use]
    pub fn function(&self) -> &Path {
        &self.function
    }

    /// The folder of the driver, in which it is unbound.
    #[must_use]
    pub fn driver(&self) -> &Path {
        &self.driver
    }

    fn give_back(&self) -> io::Result<()> {
        // Also of a function that could not be bound: the choice of the driver was made before.
        let unbound = fs::write(self.driver.join("unbind"), &self.name);
        fs::write(self.function.join(OVERRIDE), &self.chosen).and(unbound)
    }
}

impl Drop for Bound {
    fn drop(&mut self) {
        if let Err(error) = self.give_back() {
            let driver = self.driver.file_name().unwrap_or_default().to_string_lossy();
            tell(format_args!(
                "takt: cannot take the driver {driver} from {}: {error}",
                self.name
            ));
        }
    }
}
