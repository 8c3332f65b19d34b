//! Memory of devices.

use takt_abi::memory::{DEVICES, DEVICES_END, PAGE};
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, quote};
use super::super::names::check_name;
use super::super::raw::{self, Keys};
use super::super::units::Bytes;
use super::source::{Bar, PciKeys, check_bar};
use super::{Owned, Taken, check_hex, platform, take};

/// Memory of a device, and where a partition sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Unique in the partition.
    pub name: String,
    /// Guest-physical start, at a page.
    pub address: u64,
    /// A whole number of pages.
    pub bytes: u64,
    /// What lies there.
    pub source: MemorySource,
}

/// Where the memory of a device comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MemorySource {
    /// The first bytes behind a register of a PCI function.
    Pci(Bar),
    /// A map of a device with a UIO driver.
    Uio {
        /// Name of the device in `/dev`.
        device: String,
        /// Which of its maps, 0 to 4.
        map: u8,
    },
    /// Host-physical memory, through `/dev/mem`.
    Physical {
        /// Where it starts, at a page.
        address: u64,
        /// It may be memory on which the host itself runs.
        shared_with_host: bool,
    },
}

/// `MAX_UIO_MAPS` in the kernel's `include/linux/uio_driver.h`.
const UIO_MAPS: i64 = 5;
/// Host-physical addresses have at most 52 bits (AMD64 volume 2, section 5.1).
const PHYSICAL_END: u64 = 1 << 52;

/// Checks the entries of a partition.
pub fn check(
    tables: &[Spanned<Keys<raw::Mmio>>],
    partition: &str,
    taken: &mut Taken,
) -> Result<Vec<DeviceMemory>, Diagnostic> {
    let mut seen: Vec<Owned> = Vec::new();
    let mut entries: Vec<DeviceMemory> = Vec::with_capacity(tables.len());
    for table in tables {
        let Keys(raw) = table.get_ref();
        let name = check_name(&raw.name)?;
        if let Some(other) = entries.iter().position(|entry| entry.name == name) {
            let found = format!("a second [[partition.mmio]] is named {}", quote(name));
            let allowed = "a name of its own for each in a partition";
            return Err(Diagnostic::new(raw.name.span(), found, allowed)
                .and(tables[other].get_ref().0.name.span(), "the other one"));
        }
        let Bytes(bytes) = *raw.size.get_ref();
        if bytes == 0 || !bytes.is_multiple_of(PAGE) || bytes > DEVICES_END - DEVICES {
            let found = format!("{} is not a possible size of device memory", Bytes(bytes));
            let allowed = format!(
                "whole pages of {}, at most {}; a shorter register takes a page",
                Bytes(PAGE),
                Bytes(DEVICES_END - DEVICES)
            );
            return Err(Diagnostic::new(raw.size.span(), found, allowed));
        }
        let address = check_hex(&raw.address, "an address", "0xd0000000")?;
        let fits = (DEVICES..=DEVICES_END - bytes).contains(&address);
        if !fits || !address.is_multiple_of(PAGE) {
            let found = format!("{} cannot lie at {address:#x} of the guest", Bytes(bytes));
            let allowed = format!(
                "a multiple of {:#x} from {DEVICES:#x} to {:#x}",
                PAGE,
                DEVICES_END - bytes
            );
            return Err(Diagnostic::new(raw.address.span(), found, allowed));
        }
        let range = [address, address + bytes - 1];
        take(&mut seen, range, partition, raw.address.span(), ["address", "addresses"])?;
        let source = check_source(raw, table, bytes, partition, taken)?;
        entries.push(DeviceMemory { name: name.to_owned(), address, bytes, source });
    }
    Ok(entries)
}

fn check_source(
    raw: &raw::Mmio,
    table: &Spanned<Keys<raw::Mmio>>,
    bytes: u64,
    partition: &str,
    taken: &mut Taken,
) -> Result<MemorySource, Diagnostic> {
    let named: Vec<_> = [("pci", &raw.pci), ("uio", &raw.uio), ("physical", &raw.physical)]
        .into_iter()
        .filter_map(|(key, value)| value.as_ref().map(|value| (key, value.span())))
        .collect();
    let allowed = "one of `pci` with `bar`, `uio` with `map`, and `physical`";
    match &named[..] {
        [] => {
            let found = "which device it is is not said";
            return Err(Diagnostic::new(table.span(), found, allowed));
        }
        [_] => {}
        [(one, there), (other, here), ..] => {
            let found = format!("both `{one}` and `{other}` say which device it is");
            return Err(
                Diagnostic::new(here.clone(), found, allowed).and(there.clone(), "the other one")
            );
        }
    }
    if let (Some(map), None) = (&raw.map, &raw.uio) {
        let found = "`map` is about a UIO device, and there is no key `uio`";
        let allowed = "`uio = \"uio0\"` beside it, or no `map`";
        return Err(Diagnostic::new(map.span(), found, allowed));
    }
    let device = [("pci", &raw.pci), ("uio", &raw.uio)]
        .into_iter()
        .find_map(|(key, value)| value.as_ref().map(|value| (key, value.span())));
    let shared_with_host = platform::check_shared(raw.shared_with_host.as_ref(), device)?;
    let keys = PciKeys {
        pci: &raw.pci,
        bar: &raw.bar,
        unbind: &raw.unbind,
        trusted_dma: &raw.trusted_dma,
        vfio: &raw.vfio,
        header: table.span(),
    };
    if let Some(bar) = check_bar(&keys, partition, taken)? {
        return Ok(MemorySource::Pci(bar));
    }
    if let Some(uio) = &raw.uio {
        return check_uio(uio, raw.map.as_ref(), table, partition, taken);
    }
    let Some(physical) = &raw.physical else {
        return Err(Diagnostic::new(table.span(), "which device it is is not said", allowed));
    };
    let address = check_hex(physical, "an address", "0xfe000000")?;
    if !address.is_multiple_of(PAGE) || address > PHYSICAL_END - bytes {
        let found = format!("{} of device memory cannot lie at {address:#x}", Bytes(bytes));
        let allowed = format!("a multiple of {PAGE:#x} below {PHYSICAL_END:#x}");
        return Err(Diagnostic::new(physical.span(), found, allowed));
    }
    let range = [address, address + bytes - 1];
    platform::check_memory(range, &physical.span(), shared_with_host)?;
    take(
        &mut taken.memory,
        range,
        partition,
        physical.span(),
        ["host's address", "host's addresses"],
    )?;
    Ok(MemorySource::Physical { address, shared_with_host })
}

fn check_uio(
    uio: &Spanned<String>,
    map: Option<&Spanned<i64>>,
    table: &Spanned<Keys<raw::Mmio>>,
    partition: &str,
    taken: &mut Taken,
) -> Result<MemorySource, Diagnostic> {
    let device = taken.uio(uio, partition)?;
    let Some(map) = map else {
        let found = format!("which map of {device} is not said");
        let allowed = "`map = 0`, the number of one of its maps, 0 to 4";
        return Err(Diagnostic::new(table.span(), found, allowed));
    };
    let number = *map.get_ref();
    if !(0..UIO_MAPS).contains(&number) {
        let found = format!("{number} is not the number of a map");
        return Err(Diagnostic::new(map.span(), found, format!("0 to {}", UIO_MAPS - 1)));
    }
    Ok(MemorySource::Uio { device, map: number as u8 })
}
