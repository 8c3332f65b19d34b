//! What partitions ask of the hardware that all share. It is the same under every schedule, and so is
//! shown once.

use super::line;
use crate::{BusLockLimit, HugePages, Partition, PartitionFile};

/// What each partition asks for and cannot do without, in the order of the file; nothing if there is
/// none.
pub fn list(out: &mut String, file: &PartitionFile) {
    let mut begun = false;
    for partition in file.partitions() {
        let wanted = wanted(partition);
        if wanted.is_empty() {
            continue;
        }
        if !begun {
            out.push_str("\nshared hardware, without which the run does not start\n");
            begun = true;
        }
        line(out, &format!("  {}", partition.name()));
        for what in wanted {
            line(out, &format!("    {what}"));
        }
    }
}

fn wanted(partition: &Partition) -> Vec<String> {
    let mut wanted = Vec::new();
    if let HugePages::Of(size) = partition.hardware().huge_pages {
        let count = partition.memory_bytes() / size.bytes();
        wanted.push(format!("memory: {count} huge pages of {size}"));
    }
    if let Some(ways) = partition.hardware().cache {
        let s = if ways == 1 { "" } else { "s" };
        wanted.push(format!(
            "cache: {ways} way{s} of the L3 cache of CPU {} for itself",
            partition.cpu().0
        ));
    }
    if let Some(percent) = partition.hardware().memory_bandwidth {
        wanted.push(format!("memory bandwidth: {percent} % at most"));
    }
    if let Some(BusLockLimit { at_most, within }) = partition.hardware().bus_locks {
        let s = if at_most == 1 { "" } else { "s" };
        wanted.push(format!("bus locks: at most {at_most} time{s} within {within}"));
    }
    wanted
}
