//! What moves or joins pages of memory behind a guest's back.
//!
//! Locked memory stays in memory, but not in its place: when the kernel moves a page or makes a
//! large one of many, KVM has to forget it, and the guest's next access is an exit of some
//! microseconds inside the kernel, in a window.

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
/// the guests is shared. How many large pages are set aside does not matter to Takt: it uses none.
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
        let set_aside = host.number("sys/kernel/mm/hugepages/hugepages-2048kB/nr_hugepages");
        let found = match set_aside {
            Some(n @ 1..) => format!(
                "no pages are joined; {n} of 2 MiB are set aside, and takt uses none of them"
            ),
            _ => "no pages are joined".into(),
        };
        return Finding::good(CHECK, found);
    }
    Finding::warning(
        CHECK,
        found.join(", "),
        "when khugepaged joins pages, an access in a scan waits for it",
        remedies.join("; "),
    )
}
