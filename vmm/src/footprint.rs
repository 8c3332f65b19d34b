//! What this process holds of the host, beside the guests' memory.
//!
//! A restart that leaves a descriptor or a mapping behind does no harm the first time, and ends a
//! plant that has run for a year. The report therefore tells what was held when the guests started
//! and what was held at the end of the run, so that growth can be seen.

use std::fs;

use takt_figures::report::Footprint;

/// What is held at this moment; `None` if the host has no `/proc` to tell it.
#[must_use]
pub fn now() -> Option<Footprint> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    // One more is open while the folder is read, each time.
    let descriptors = fs::read_dir("/proc/self/fd").ok()?.count().saturating_sub(1);
    Some(Footprint { anonymous_bytes: anonymous_bytes(&status)?, descriptors: descriptors as u64 })
}

/// The value of `RssAnon`, which the kernel gives in units of 1024 bytes.
fn anonymous_bytes(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kibibytes: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    kibibytes.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_opened_and_allocated_is_counted() {
        let before = now().unwrap();
        let files: Vec<_> = (0..100).map(|_| fs::File::open("/dev/null").unwrap()).collect();
        let memory = std::hint::black_box(vec![1u8; 16 << 20]);
        let after = now().unwrap();
        // Other tests open and allocate at the same time.
        assert!(after.descriptors >= before.descriptors + 50, "{before:?} {after:?}");
        assert!(
            after.anonymous_bytes >= before.anonymous_bytes + (8 << 20),
            "{before:?} {after:?}"
        );
        drop((files, memory));
    }

    #[test]
    fn a_status_without_the_value_is_no_figure() {
        assert_eq!(anonymous_bytes("Name:\tx\nRssAnon:\t     132 kB\n"), Some(132 << 10));
        for status in ["", "RssAnon:", "RssAnon:\t1 MB", "RssAnon:\t-1 kB", "RssFile:\t1 kB"] {
            assert_eq!(anonymous_bytes(status), None, "{status:?}");
        }
        assert_eq!(anonymous_bytes(&format!("RssAnon: {} kB", u64::MAX)), None);
    }
}
