//! Finding the PCI function in sysfs.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::PortsError;
use crate::table::Region;

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

/// Where a memory region of the function is in physical memory, by the line of that number in its file `resource`: first
/// and last address, and flags (kernel, Documentation/PCI/sysfs-pci.rst). `None` if this is no function of the
/// kernel's, or has no such region.
pub(crate) fn region(function: &Path, number: usize) -> Option<Region> {
    if !function.starts_with("/sys/") {
        return None;
    }
    region_of(&fs::read_to_string(function.join("resource")).ok()?, number)
}

fn region_of(resource: &str, number: usize) -> Option<Region> {
    let mut fields = resource.lines().nth(number)?.split(' ').map(parse);
    let (first, last) = (fields.next()??, fields.next()??);
    let bytes = last.checked_sub(first)?.checked_add(1)?;
    (first != 0).then_some(Region { offset: first, bytes })
}

/// A number as sysfs writes it.
fn parse(text: &str) -> Option<u64> {
    u64::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok()
}

/// A file with a number as sysfs writes it.
fn number(path: &Path) -> Option<u32> {
    u32::try_from(parse(&fs::read_to_string(path).ok()?)?).ok()
}

#[cfg(test)]
#[path = "function_tests.rs"]
mod tests;
