//! What is below the host's kernel.

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::Host;

/// Whether the host is a physical machine, and not a guest.
pub fn bare_metal(host: &Host) -> Finding {
    const CHECK: &str = "bare-metal";
    let model = host.processor("model name").unwrap_or_else(|| "unknown".into());
    if !host.has_feature("hypervisor") {
        return Finding::good(CHECK, format!("no hypervisor shows itself ({model})"));
    }
    Finding::warning(
        CHECK,
        format!("this host is a virtual machine ({model})"),
        "the host below can take its CPUs away at any time, and no setting in here prevents it",
        "run takt on the machine itself; or give this machine physical CPUs of its own there",
    )
}

/// Whether devices can be kept from memory that is not theirs. It matters where a PLC has one that
/// masters the bus.
pub fn iommu(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "iommu";
    let groups = host.names("sys/kernel/iommu_groups").len();
    let found = match groups {
        0 => "none in use".to_owned(),
        n => format!("in use, {n} groups of devices"),
    };
    if demand.trusted_dma.is_empty() {
        return Finding::good(CHECK, format!("{found}; the PLCs need none"));
    }
    Finding::warning(
        CHECK,
        format!("{found}; {} may master the bus (trusted_dma)", demand.trusted_dma.join(", ")),
        "who programs these devices can read and write all memory of the host and of Linux",
        "take trusted_dma out of the partition file wherever the device works without it",
    )
}
