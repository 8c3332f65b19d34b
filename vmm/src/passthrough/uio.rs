//! The host's part of a device's interrupt: a UIO driver.
//!
//! VFIO hands over an eventfd at once, but only for functions behind an I/O memory management unit.
//! UIO needs none.

use std::fs::{self, File};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use super::bound::Bound;
use super::error::DeviceError;
use crate::interrupts::line::{self, Line};

/// Opens the device of a PCI function that is bound to `uio_pci_generic`, in `devices`, which is
/// `/dev`.
///
/// # Errors
/// See [`DeviceError`].
pub fn of_function(bound: &Bound, name: &str, devices: &Path) -> Result<File, DeviceError> {
    let folder = bound.function().join("uio");
    let unexpected = || DeviceError::Unexpected(folder.clone());
    let mut entries = fs::read_dir(&folder).map_err(|_| unexpected())?;
    let device = entries.next().and_then(Result::ok).ok_or_else(unexpected)?.file_name();
    open(&devices.join(device), name)
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
