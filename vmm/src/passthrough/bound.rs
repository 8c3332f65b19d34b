//! Binding a PCI function to a driver of the kernel's that hands it to a process, by its address, since
//! numbers of devices depend on who came first.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use super::error::DeviceError;
use crate::appliance::{self, Role};
use crate::outlet::last_line;

/// The file of a function that names the only driver which may be bound to it.
pub(super) const OVERRIDE: &str = "driver_override";

/// How often, and how far apart, a group is looked at that another process has open. What a killed Takt had is let go of when its guardian
/// has written safe values and the function has been reset: a bus may take more than a second for that.
const LOOKS: u32 = 30;
const BETWEEN_LOOKS: Duration = Duration::from_millis(100);

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

    /// Whether another process has the group of this function open and keeps it, such as a virtual machine of the host's.
    fn is_used(self, function: &Path) -> bool {
        let group = fs::read_link(function.join("iommu_group")).unwrap_or_default();
        let Some(group) = group.file_name().filter(|_| self == HostDriver::Vfio) else {
            return false;
        };
        let path = Path::new("/dev/vfio").join(group);
        let is_busy = || {
            let opened = File::options().read(true).write(true).open(&path);
            opened.is_err_and(|error| error.kind() == io::ErrorKind::ResourceBusy)
        };
        stays(is_busy, || thread::sleep(BETWEEN_LOOKS))
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

/// Whether something holds at each of [`LOOKS`] looks.
fn stays(mut holds: impl FnMut() -> bool, wait: impl Fn()) -> bool {
    (0..LOOKS).all(|look| {
        if look > 0 {
            wait();
        }
        holds()
    })
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
            let text = format!("cannot take the driver {driver} from {}: {error}", self.name);
            last_line(&mut io::stderr(), &text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_that_is_let_go_of_while_one_looks_is_free() {
        let mut looks = 0;
        assert!(!stays(
            || {
                looks += 1;
                looks < 5
            },
            || ()
        ));
        assert_eq!(looks, 5);
        assert!(stays(|| true, || ()));
    }
}
