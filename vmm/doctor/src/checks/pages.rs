//! What moves or joins pages of memory behind a guest's back, and the huge pages that are set aside for guests.
//!
//! Locked memory stays in memory, but not in its place: when the kernel moves a page or makes a
//! large one of many, KVM has to forget it, and the guest's next access is an exit of some
//! microseconds inside the kernel, in a window.

use takt_host::huge_pages;
use takt_plan::{HugePageSize, HugePages};

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::Host;

/// Whether pages are moved: for large free areas, or to another memory node.
pub fn moved(host: &Host) -> Finding {
    const CHECK: &str = "moved-pages";
    let mut found = Vec::new();
    let mut remedies = Vec::new();
    if host.number("proc/sys/vm/compact_unevictable_allowed") == Some(1) {
        found.push("compaction moves locked pages");
        remedies.push("sysctl vm.compact_unevictable_allowed=0");
    }
    let nodes = host.cpus("sys/devices/system/node/online").map_or(1, |nodes| nodes.len());
    if nodes > 1 && host.number("proc/sys/kernel/numa_balancing").is_some_and(|n| n != 0) {
        found.push("the kernel balances memory between nodes");
        remedies.push("sysctl kernel.numa_balancing=0");
    }
    if found.is_empty() {
        return Finding::good(CHECK, "locked pages stay where they are");
    }
    Finding::warning(
        CHECK,
        found.join(", "),
        "an access in a scan takes microseconds instead of nanoseconds, once for each page that has moved",
        remedies.join("; "),
    )
}

/// Whether pages are joined to large ones while guests run. Takt's own memory is anonymous, that of
/// the guests is shared.
pub fn huge(host: &Host) -> Finding {
    const CHECK: &str = "huge-pages";
    const FOLDER: &str = "sys/kernel/mm/transparent_hugepage";
    let own = host.chosen(&format!("{FOLDER}/enabled"));
    let guests = host.chosen(&format!("{FOLDER}/shmem_enabled"));
    let mut found = Vec::new();
    let mut remedies = Vec::new();
    if own.as_deref() == Some("always") {
        found.push("pages of every program are joined to large ones (THP always)");
        remedies.push(format!("echo madvise > /{FOLDER}/enabled"));
    }
    if guests.as_deref().is_some_and(|mode| ["always", "within_size", "force"].contains(&mode)) {
        found.push("so are those of guests (THP for shared memory)");
        remedies.push(format!("echo never > /{FOLDER}/shmem_enabled"));
    }
    if found.is_empty() {
        return Finding::good(CHECK, "no pages are joined");
    }
    Finding::warning(
        CHECK,
        found.join(", "),
        "when khugepaged joins pages, an access in a scan waits for it",
        remedies.join("; "),
    )
}

/// Whether the host has the huge pages set aside that partitions insist on. One that would only like to have
/// some does without, and no release is late for it.
pub fn set_aside(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "huge-pages-set-aside";
    let mut found = Vec::new();
    for size in HugePageSize::ALL {
        let (wanted, liked) = asked(demand, size);
        let pool = huge_pages::pool_below(host.root(), size.bytes());
        let (total, free) = pool.map_or((0, 0), |pool| (pool.total, pool.free));
        if wanted > free {
            let needed = total + (wanted - free);
            let folder = huge_pages::folder(size.bytes());
            let remedy = match pool {
                Some(_) => format!("echo {needed} > {folder}/nr_hugepages"),
                None => "a size of huge pages that the processor has, in the partition file".into(),
            };
            return Finding::cannot(
                CHECK,
                format!("{free} of {size} are free, of {total}; partitions insist on {wanted}"),
                "takt run does not start",
                remedy,
            );
        }
        let likes = match liked {
            0 => String::new(),
            _ if wanted + liked <= free => format!(", {liked} of them for a Linux"),
            _ => format!(", too few for the {liked} of a Linux, which does without"),
        };
        if total > 0 || liked > 0 {
            found.push(format!("{free} of {size} are free{likes}"));
        }
    }
    if found.is_empty() {
        found.push("none are set aside, and none are asked for".into());
    }
    Finding::good(CHECK, found.join("; "))
}

/// How many bytes of the guests' memory come out of what is set aside.
pub fn from_set_aside(host: &Host, demand: &Demand) -> u64 {
    let of = |size: &HugePageSize| {
        let (wanted, liked) = asked(demand, *size);
        let free = huge_pages::pool_below(host.root(), size.bytes()).map_or(0, |pool| pool.free);
        let taken = if wanted + liked <= free { wanted + liked } else { wanted.min(free) };
        taken * size.bytes()
    };
    HugePageSize::ALL.iter().map(of).sum()
}

/// How many huge pages of this size partitions insist on, and how many more they would like to have.
fn asked(demand: &Demand, size: HugePageSize) -> (u64, u64) {
    let mut sums = (0, 0);
    for &(pages, memory) in &demand.pages {
        let count = memory / size.bytes();
        match pages {
            HugePages::Of(of) if of == size => sums.0 += count,
            HugePages::Auto if size == HugePageSize::TwoMiB && memory % size.bytes() == 0 => {
                sums.1 += count;
            }
            _ => {}
        }
    }
    sums
}
