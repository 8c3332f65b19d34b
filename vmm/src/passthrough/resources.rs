//! What the host's kernel says of its ports and memory: `/proc/ioports` and `/proc/iomem`.
//!
//! What of the host lies at the same numbers on every PC, the partition file's own check refuses. The
//! rest is known here only: where RAM is, and where this machine has its power management, its
//! interrupt controllers, its IOMMU and the memory that configures its PCI functions.

use std::fs;

use super::error::DeviceError;
use crate::config::{DeviceMemory, MemorySource, Passthrough, PortIo};

const PORTS: &str = "/proc/ioports";
const MEMORY: &str = "/proc/iomem";

/// What the kernel calls its own: `acpi_reserve_resources` (`drivers/acpi/osl.c`), of which the name
/// begins like this.
const OWN_PORTS: [&str; 1] = ["ACPI "];
/// The same for memory: `arch/x86/kernel/apic`, `drivers/acpi/acpica`, `arch/x86/pci/mmconfig-shared.c`
/// ("MMCONFIG" up to 6.10), `drivers/iommu/intel/dmar.c`, `drivers/iommu/amd/init.c`.
const OWN_MEMORY: [&str; 7] =
    ["Local APIC", "IOAPIC ", "HPET ", "PCI MMCONFIG ", "PCI ECAM ", "dmar", "amd_iommu"];
const RAM: &str = "System RAM";

/// Refuses what a run on this host would refuse of the numbers in a file. A user to whom the kernel shows no numbers is refused
/// nothing.
///
/// # Errors
/// [`DeviceError::Ram`], [`DeviceError::Own`].
pub fn check(numbers: &Passthrough) -> Result<(), DeviceError> {
    for PortIo { first, last, bar, shared_with_host } in &numbers.ports {
        if bar.is_none() && !shared_with_host {
            if_shown(check_ports((*first).into(), (*last).into()))?;
        }
    }
    for DeviceMemory { bytes, source, .. } in &numbers.memory {
        if let MemorySource::Physical { address, shared_with_host } = *source {
            if_shown(check_memory(address, address + (bytes - 1), shared_with_host))?;
        }
    }
    Ok(())
}

fn if_shown(found: Result<(), DeviceError>) -> Result<(), DeviceError> {
    found.or_else(|error| match error {
        DeviceError::Host { .. } => Ok(()),
        other => Err(other),
    })
}

/// Refuses ports on which this host runs.
///
/// # Errors
/// [`DeviceError::Own`], or that the kernel's list cannot be read.
pub fn check_ports(first: u64, last: u64) -> Result<(), DeviceError> {
    let text = read(PORTS, || format!("the ports {first:#x} to {last:#x}"))?;
    match owner(&text, first, last, &OWN_PORTS) {
        None => Ok(()),
        Some(name) => Err(DeviceError::Own {
            what: "ports",
            first,
            last,
            owner: name.to_owned(),
            list: PORTS,
        }),
    }
}

/// Refuses RAM, and memory on which this host runs unless it is meant to be `shared`.
///
/// # Errors
/// [`DeviceError::Ram`], [`DeviceError::Own`], or that the kernel's list cannot be read.
pub fn check_memory(first: u64, last: u64, shared: bool) -> Result<(), DeviceError> {
    let text = read(MEMORY, || format!("physical memory at {first:#x}"))?;
    if owner(&text, first, last, &[RAM]).is_some() {
        return Err(DeviceError::Ram(first, last));
    }
    match owner(&text, first, last, &OWN_MEMORY).filter(|_| !shared) {
        None => Ok(()),
        Some(name) => {
            let owner = name.to_owned();
            Err(DeviceError::Own { what: "addresses", first, last, owner, list: MEMORY })
        }
    }
}

fn read(path: &str, device: impl Fn() -> String) -> Result<String, DeviceError> {
    let what = "look for what the host itself uses of";
    fs::read_to_string(path).map_err(|source| DeviceError::Host { what, device: device(), source })
}

/// The name of an entry that touches the range, of those whose name begins like one of `names`. An
/// entry that cannot be read counts as one that does. (A user other than root sees all numbers in the
/// lists as zeros, but cannot use ports or open `/dev/mem` either.)
fn owner<'a>(list: &'a str, first: u64, last: u64, names: &[&str]) -> Option<&'a str> {
    list.lines().find_map(|line| {
        let (range, name) = line.split_once(" : ")?;
        let own = names.iter().any(|own| name.starts_with(own));
        let number = |text| u64::from_str_radix(text, 16).ok();
        let meets = range
            .trim_start()
            .split_once('-')
            .and_then(|(from, to)| Some((number(from)?, number(to)?)))
            .is_none_or(|(from, to)| from <= last && first <= to);
        (own && meets).then_some(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const IOMEM: &str = "00000000-00000fff : Reserved\n00001000-0009fbff : System RAM\n\
        00100000-3fffffff : System RAM\n  01000000-01ffffff : Kernel code\n\
        e0000000-efffffff : PCI MMCONFIG 0000 [bus 00-ff]\n  e0000000-efffffff : Reserved\n\
        fec00000-fec003ff : IOAPIC 0\nfed00000-fed003ff : HPET 0\n  fed00000-fed003ff : PNP0103:00\n\
        fed90000-fed90fff : dmar0\nfee00000-fee00fff : Local APIC\n";
    const IOPORTS: &str = "0000-0cf7 : PCI Bus 0000:00\n  0378-037a : parport0\n\
        0d00-ffff : PCI Bus 0000:00\n  0600-0603 : ACPI PM1a_EVT_BLK\n  0608-060b : ACPI PM_TMR\n";

    fn is_ram(first: u64, last: u64) -> bool {
        owner(IOMEM, first, last, &[RAM]).is_some()
    }

    #[test]
    fn ram_is_found_wherever_the_range_touches_it() {
        assert!(!is_ram(0xfed0_0000, 0xfed0_0fff));
        assert!(!is_ram(0xa0000, 0xfffff));
        assert!(is_ram(0xa0000, 0x10_0000));
        assert!(is_ram(0x3fff_f000, 0x4000_0fff));
        assert!(is_ram(0x200_0000, 0x200_0fff));
        assert!(is_ram(0, u64::MAX));
    }

    #[test]
    fn what_the_host_runs_on_is_found_by_its_name() {
        let memory = |first, last| owner(IOMEM, first, last, &OWN_MEMORY);
        assert_eq!(memory(0xe800_0000, 0xe800_0fff), Some("PCI MMCONFIG 0000 [bus 00-ff]"));
        assert_eq!(memory(0xfed9_0000, 0xfed9_0fff), Some("dmar0"));
        assert_eq!(memory(0xfed0_0000, 0xfed0_0fff), Some("HPET 0"));
        assert_eq!(memory(0xfea0_0000, 0xfea0_0fff), None);
        let ports = |first, last| owner(IOPORTS, first, last, &OWN_PORTS);
        assert_eq!(ports(0x60b, 0x60f), Some("ACPI PM_TMR"));
        assert_eq!(ports(0x378, 0x37a), None);
        assert_eq!(ports(0x604, 0x607), None);
    }

    #[test]
    fn an_entry_that_cannot_be_read_counts_as_one_that_touches() {
        assert!(owner("nonsense : System RAM\n", 0xfed0_0000, 0xfed0_0fff, &[RAM]).is_some());
        assert!(owner("nonsense : HPET 0\n", 0xfed0_0000, 0xfed0_0fff, &[RAM]).is_none());
    }
}
