//! Finding the PCI function in sysfs.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::PortsError;

/// Vendor of the function.
pub const VENDOR: u32 = 0x1af4;
/// Its device number, one of those that the vendor leaves to experiments.
pub const DEVICE: u32 = 0x10f0;

/// The folder of the first function of this kind below a folder such as `/sys/bus/pci/devices`.
pub(crate) fn find(devices: &Path) -> Result<PathBuf, PortsError> {
    let not_found = || PortsError::NotFound(devices.to_owned());
    // Without PCI there is no such folder.
    let entries = fs::read_dir(devices).map_err(|_| not_found())?;
    let mut folders: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    folders.sort();
    let is = |folder: &Path, name: &str, expected| number(&folder.join(name)) == Some(expected);
    let found = folders
        .into_iter()
        .find(|folder| is(folder, "vendor", VENDOR) && is(folder, "device", DEVICE));
    found.ok_or_else(not_found)
}

/// The device file through which the function's interrupts can be waited for, if a driver is
/// bound that offers one.
pub(crate) fn uio(function: &Path) -> Option<PathBuf> {
    let mut entries = fs::read_dir(function.join("uio")).ok()?.flatten();
    let name = entries.find_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        name.starts_with("uio").then_some(name)
    })?;
    Some(Path::new("/dev").join(name))
}

/// A file with a number as sysfs writes it.
fn number(path: &Path) -> Option<u32> {
    let text = fs::read_to_string(path).ok()?;
    u32::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok()
}

#[cfg(test)]
#[path = "function_tests.rs"]
mod tests;
