//! Memory for the guests, all of which is taken and locked at the start.

use super::pages;
use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::{Capability, Host};

/// What Takt itself takes beside the guests, and then some.
const OWN: u64 = 64 << 20;

/// Whether there is enough.
pub fn available(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "memory";
    let text = host.text("proc/meminfo").unwrap_or_default();
    let available = text.lines().find_map(|line| {
        line.strip_prefix("MemAvailable:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok()
    });
    let Some(kib) = available else {
        let remedy = "a kernel that tells MemAvailable in /proc/meminfo";
        return Finding::unseen(
            CHECK,
            "the kernel does not tell",
            "takt run may not start",
            remedy,
        );
    };
    // What is set aside is not among what is available.
    let set_aside = pages::from_set_aside(host, demand);
    let needed = demand.memory - set_aside.min(demand.memory);
    let mut found = format!("{} available, {} for the guests", mib(kib << 10), mib(needed));
    if set_aside > 0 {
        found += &format!(" and {} of theirs in huge pages that are set aside", mib(set_aside));
    }
    if needed + OWN <= kib << 10 {
        return Finding::good(CHECK, found);
    }
    Finding::cannot(
        CHECK,
        found,
        "takt run does not start, or the kernel ends programs to find memory",
        "end other programs, or give the partitions less `memory`",
    )
}

/// Whether it may be locked.
pub fn locking(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "memlock";
    if host.may(Capability::LockMemory) {
        return Finding::good(CHECK, "no limit for this user (CAP_IPC_LOCK)");
    }
    let limits = host.text("proc/self/limits").unwrap_or_default();
    let line = limits.lines().find_map(|line| line.strip_prefix("Max locked memory"));
    let limit = line.and_then(|line| line.split_whitespace().next()).unwrap_or("?");
    let needed = demand.memory + OWN;
    if limit == "unlimited" || limit.parse::<u64>().is_ok_and(|bytes| bytes >= needed) {
        return Finding::good(CHECK, format!("limit {limit}"));
    }
    let found = format!("this user may lock {limit} bytes, and takt needs {}", mib(needed));
    let cost =
        "takt run does not start: a page that comes and goes would be a page fault in a window";
    // Only a user who may use real-time classes can run takt; others are only looking.
    if host.may(Capability::Schedule) {
        Finding::cannot(CHECK, found, cost, "ulimit -l unlimited")
    } else {
        Finding::unseen(CHECK, found, cost, format!("sudo {}", demand.command()))
    }
}

fn mib(bytes: u64) -> String {
    format!("{} MiB", bytes >> 20)
}
