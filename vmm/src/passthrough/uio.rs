//! The host's part of a device's interrupt: a UIO driver.
//!
//! VFIO would hand over an eventfd at once, but only for functions behind an I/O memory management
//! unit. UIO needs none. For a PCI function Takt binds the kernel's `uio_pci_generic` itself, by its
//! address, since numbers of UIO devices depend on who came first.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use super::error::DeviceError;
use crate::appliance;
use crate::interrupts::line::{self, Line};

const DRIVER: &str = "uio_pci_generic";

/// A PCI function that is bound to `uio_pci_generic`, until this is dropped.
#[derive(Debug)]
pub struct Bound {
    function: PathBuf,
    driver: PathBuf,
    name: String,
}

impl Bound {
    /// Binds the function `name`, of the folder `function`, to the driver in `drivers`.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn bind(function: &Path, drivers: &Path, name: &str) -> Result<Self, DeviceError> {
        let cannot =
            |what| move |source| DeviceError::Host { what, device: name.to_owned(), source };
        let driver = drivers.join(DRIVER);
        if !driver.exists() {
            appliance::load_for_interrupts().map_err(cannot("load the UIO driver for"))?;
        }
        if !driver.exists() {
            return Err(DeviceError::NoUio(name.to_owned()));
        }
        let this = Self { function: function.to_owned(), driver, name: name.to_owned() };
        fs::write(this.function.join("driver_override"), DRIVER)
            .map_err(cannot("choose the UIO driver for"))?;
        // From here on the drop undoes it.
        fs::write(this.driver.join("bind"), name).map_err(cannot("bind the UIO driver to"))?;
        Ok(this)
    }

    /// Opens its device in `devices`, which is `/dev`.
    ///
    /// # Errors
    /// See [`DeviceError`].
    pub fn open(&self, devices: &Path) -> Result<File, DeviceError> {
        let folder = self.function.join("uio");
        let unexpected = || DeviceError::Unexpected(folder.clone());
        let mut entries = fs::read_dir(&folder).map_err(|_| unexpected())?;
        let device = entries.next().and_then(Result::ok).ok_or_else(unexpected)?.file_name();
        open(&devices.join(device), &self.name)
    }

    /// The folder of the driver, in which it is unbound.
    #[must_use]
    pub fn driver(&self) -> &Path {
        &self.driver
    }

    fn give_back(&self) -> io::Result<()> {
        // Also of a function that could not be bound: the choice of the driver was made before.
        let unbound = fs::write(self.driver.join("unbind"), &self.name);
        fs::write(self.function.join("driver_override"), "\n").and(unbound)
    }
}

impl Drop for Bound {
    fn drop(&mut self) {
        if let Err(error) = self.give_back() {
            eprintln!("takt: cannot take the UIO driver from {}: {error}", self.name);
        }
    }
}

/// The line of a device with a UIO driver of its own, closed.
///
/// # Errors
/// See [`DeviceError`]; also if the driver cannot close it.
pub fn line_of(device: &str) -> Result<Line, DeviceError> {
    let uio = open(&Path::new("/dev").join(device), device)?;
    line::switch(&uio, false)
        .map_err(|source| DeviceError::NoSwitch { device: device.to_owned(), source })?;
    Ok(Line::Uio(uio))
}

fn open(path: &Path, device: &str) -> Result<File, DeviceError> {
    let file = File::options().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(path);
    file.map_err(|source| DeviceError::Missing {
        device: device.to_owned(),
        path: path.into(),
        source,
    })
}
