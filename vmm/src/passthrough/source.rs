//! Opening a device's memory: behind a register, by a UIO driver, or at a physical address.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use takt_abi::memory::PAGE;

use super::error::DeviceError;
use super::mapping::Mapping;
use super::pci::Function;
use super::resources;

/// The first `bytes` behind a register of `function`, and where the host has them.
///
/// # Errors
/// See [`DeviceError`].
pub fn map_bar(function: &Function, bar: u8, bytes: u64) -> Result<(Mapping, u64), DeviceError> {
    let name = function.name();
    let kind = || DeviceError::BarKind { function: name.to_owned(), bar, wanted: "memory" };
    let resource = function.resource(bar)?.filter(|r| r.is_memory()).ok_or_else(kind)?;
    let device = format!("register {bar} of {name}");
    check_fit(&device, resource.start, resource.length, bytes)?;
    if let Some(confined) = function.confined() {
        let cannot = |source| DeviceError::Host { what: "map", device: device.clone(), source };
        let (file, offset) = confined.memory(bar).map_err(cannot)?.ok_or_else(kind)?;
        return Ok((map(file, offset, bytes, &device)?, resource.start));
    }
    let file = open(&function.resource_file(bar), &device)?;
    Ok((map(&file, 0, bytes, &device)?, resource.start))
}

/// The first `bytes` of a map of a UIO device, and where the host has them.
///
/// # Errors
/// See [`DeviceError`].
pub fn map_uio(device: &str, map_index: u8, bytes: u64) -> Result<(Mapping, u64), DeviceError> {
    let folder = Path::new("/sys/class/uio").join(device).join(format!("maps/map{map_index}"));
    let name = format!("map {map_index} of {device}");
    let number = |key: &str| {
        let path = folder.join(key);
        let text = fs::read_to_string(&path).map_err(|source| DeviceError::Missing {
            device: name.clone(),
            path: path.clone(),
            source,
        })?;
        let digits = text.trim().strip_prefix("0x").unwrap_or_default();
        u64::from_str_radix(digits, 16).map_err(|_| DeviceError::Unexpected(path))
    };
    let start = number("addr")?.saturating_add(number("offset")?);
    check_fit(&name, start, number("size")?, bytes)?;
    let file = open(&Path::new("/dev").join(device), &name)?;
    // The offset chooses the map (Documentation/driver-api/uio-howto.rst, "mmap()").
    Ok((map(&file, u64::from(map_index) * PAGE, bytes, &name)?, start))
}

/// Host-physical memory that is no RAM, and nothing on which the host runs unless it is meant to be
/// `shared`.
///
/// # Errors
/// See [`DeviceError`].
pub fn map_physical(address: u64, bytes: u64, shared: bool) -> Result<Mapping, DeviceError> {
    resources::check_memory(address, address + (bytes - 1), shared)?;
    let device = format!("physical memory at {address:#x}");
    let file = open(Path::new("/dev/mem"), &device)?;
    map(&file, address, bytes, &device)
}

/// A guest gets whole pages, so what lies in the last one behind the device's memory is the
/// guest's as well; in front of it there must be nothing.
fn check_fit(device: &str, start: u64, length: u64, wanted: u64) -> Result<(), DeviceError> {
    let device = device.to_owned();
    if !start.is_multiple_of(PAGE) {
        return Err(DeviceError::Unaligned { device, start });
    }
    if wanted > length.checked_next_multiple_of(PAGE).unwrap_or(length) {
        return Err(DeviceError::TooShort { device, has: length, wanted, unit: "bytes" });
    }
    Ok(())
}

/// Synchronous, which for `/dev/mem` means uncached.
fn open(path: &Path, device: &str) -> Result<File, DeviceError> {
    use std::os::unix::fs::OpenOptionsExt;

    let file = File::options().read(true).write(true).custom_flags(libc::O_SYNC).open(path);
    file.map_err(|source| DeviceError::Missing {
        device: device.to_owned(),
        path: path.into(),
        source,
    })
}

fn map(file: &File, offset: u64, bytes: u64, device: &str) -> Result<Mapping, DeviceError> {
    Mapping::new(file, offset, bytes).map_err(|source: io::Error| DeviceError::Host {
        what: "map",
        device: device.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_starts_at_a_page_and_is_as_long_as_was_asked_for() {
        assert!(check_fit("d", 0xfea0_0000, 0x80, PAGE).is_ok());
        assert!(check_fit("d", 0xfea0_0000, 0x80, 2 * PAGE).is_err());
        assert!(check_fit("d", 0xfea0_0080, 0x80, PAGE).is_err());
        assert!(check_fit("d", 0, u64::MAX, u64::MAX - PAGE + 1).is_ok());
    }
}
