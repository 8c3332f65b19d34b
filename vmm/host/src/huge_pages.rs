//! How many huge pages the host has set aside.
//!
//! Huge pages are set aside by the host's owner, at its start or later
//! (`Documentation/admin-guide/mm/hugetlbpage.rst`), and serve no other purpose. The other kind, large pages that the
//! kernel makes of small ones by itself (THP), a PREEMPT_RT kernel does not have (`mm/Kconfig`).

use std::fs;
use std::path::Path;

const FOLDER: &str = "sys/kernel/mm/hugepages";

/// Huge pages of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pool {
    /// All that are set aside.
    pub total: u64,
    /// Those that can be had: a page that is free may be promised to a program already.
    pub free: u64,
}

/// The folder of the kernel's that counts huge pages of so many bytes.
#[must_use]
pub fn folder(page: u64) -> String {
    format!("/{FOLDER}/hugepages-{}kB", page >> 10)
}

/// The huge pages of so many bytes; `None` if the host has no such size.
#[must_use]
pub fn pool(page: u64) -> Option<Pool> {
    pool_below(Path::new("/"), page)
}

/// As [`pool`], of a host whose files lie below `top`, as those of a record do.
#[must_use]
pub fn pool_below(top: &Path, page: u64) -> Option<Pool> {
    let folder = top.join(folder(page).trim_start_matches('/'));
    let number = |name: &str| fs::read_to_string(folder.join(name)).ok()?.trim().parse().ok();
    let total = number("nr_hugepages")?;
    let free: u64 = number("free_hugepages").unwrap_or(total);
    let promised = number("resv_hugepages").unwrap_or(0);
    Some(Pool { total, free: free.saturating_sub(promised) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_promised_cannot_be_had() {
        let top = std::env::temp_dir().join(format!("takt-huge-pages-{}", std::process::id()));
        let folder = top.join("sys/kernel/mm/hugepages/hugepages-2048kB");
        fs::create_dir_all(&folder).unwrap();
        for (name, text) in [("nr_hugepages", "8\n"), ("free_hugepages", "5\n")] {
            fs::write(folder.join(name), text).unwrap();
        }
        let found = |page| pool_below(&top, page);
        assert_eq!(found(2 << 20), Some(Pool { total: 8, free: 5 }));
        assert_eq!(found(1 << 30), None);
        fs::write(folder.join("resv_hugepages"), "2\n").unwrap();
        assert_eq!(found(2 << 20), Some(Pool { total: 8, free: 3 }));
        fs::write(folder.join("nr_hugepages"), "many\n").unwrap();
        assert_eq!(found(2 << 20), None);
        fs::remove_dir_all(top).unwrap();
    }
}
