//! System management interrupts: the firmware's, which take all CPUs from the kernel unseen.
//!
//! Intel's processors count them in `MSR_SMI_COUNT` (0x34; Software Developer's Manual, volume 4).
//! Others have no counter that can simply be read; there, the gaps of `latency` must do.

use std::fs::File;
use std::os::unix::fs::FileExt;

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::Host;

const MSR_SMI_COUNT: u64 = 0x34;

/// The counter of the first CPU with windows, if it can be read.
#[must_use]
pub fn count(host: &Host, demand: &Demand) -> Option<u32> {
    let cpu = demand.cpus().first()?.0;
    let file = File::open(host.root().join(format!("dev/cpu/{cpu}/msr"))).ok()?;
    let mut value = [0; 8];
    file.read_exact_at(&mut value, MSR_SMI_COUNT).ok()?;
    // The upper half is reserved.
    Some(u64::from_le_bytes(value) as u32)
}

/// Says what two readings mean.
#[must_use]
pub fn finding(host: &Host, demand: &Demand, before: Option<u32>, after: Option<u32>) -> Finding {
    const CHECK: &str = "smi";
    const COST: &str = "the firmware stops all CPUs for as long as it likes, often 100 us and more, and no kernel sees it";
    let intel = host.processor("vendor_id").as_deref() == Some("GenuineIntel");
    match (before, after) {
        (Some(before), Some(after)) => match after.wrapping_sub(before) {
            0 => Finding::good(CHECK, format!("none while measuring, {after} since the start")),
            n => Finding::warning(
                CHECK,
                format!("{n} while measuring, {after} since the start"),
                COST,
                "in the firmware's settings: USB legacy support, power management and error logging off; then the firmware's update",
            ),
        },
        _ if host.has_feature("hypervisor") => {
            Finding::good(CHECK, "not visible in a virtual machine; the gaps below show them too")
        }
        _ if intel => Finding::unseen(
            CHECK,
            "the processor's counter cannot be read",
            COST,
            format!("sudo modprobe msr; sudo {}", demand.command()),
        ),
        _ => Finding::good(CHECK, "this processor has no counter; the gaps below show them too"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Severity;
    use crate::recorded::Recorded;

    #[test]
    fn the_counter_is_believed_where_there_is_one() {
        let tree = Recorded::named("workstation").unpack();
        let demand = Demand::usual(&tree.host);
        let of = |before, after| finding(&tree.host, &demand, before, after).severity;
        assert_eq!(of(Some(7), Some(7)), Severity::Good);
        assert_eq!(of(Some(u32::MAX), Some(1)), Severity::Warning);
        assert_eq!(of(None, None), Severity::Unseen);
        let others = ["appliance-rt", "virtual-machine"];
        for name in others {
            let tree = Recorded::named(name).unpack();
            assert_eq!(finding(&tree.host, &demand, None, None).severity, Severity::Good);
        }
    }

    #[test]
    fn the_counter_is_read_at_its_number() {
        let registers: String = (0..0x34).map(|_| '\0').chain("*\0\0\0\0\0\0\0".chars()).collect();
        let tree = Recorded::named("workstation").with("dev/cpu/7/msr", &registers).unpack();
        assert_eq!(count(&tree.host, &Demand::usual(&tree.host)), Some(42));
        let short = Recorded::named("workstation").with("dev/cpu/7/msr", "*").unpack();
        assert_eq!(count(&short.host, &Demand::usual(&short.host)), None);
    }
}
