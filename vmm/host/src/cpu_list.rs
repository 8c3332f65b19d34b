//! The kernel's lists of CPUs, such as `0-3,6` (`Documentation/admin-guide/cgroup-v2.rst`,
//! "cpuset.cpus").

use takt_scheduler::table::Cpu;

/// More CPUs than any kernel has; bounds what a list may make this process allocate.
const MANY: usize = 1 << 16;

/// The CPUs of a list; `None` if it is none.
#[must_use]
pub fn parse(text: &str) -> Option<Vec<Cpu>> {
    let mut cpus = Vec::new();
    for range in text.trim().split(',').filter(|range| !range.is_empty()) {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (usize, usize) = (first.parse().ok()?, last.parse().ok()?);
        if last < first || last >= MANY {
            return None;
        }
        cpus.extend((first..=last).map(Cpu));
    }
    Some(cpus)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(text: &str) -> Option<Vec<usize>> {
        parse(text).map(|cpus| cpus.into_iter().map(|Cpu(n)| n).collect())
    }

    #[test]
    fn ranges_and_single_cpus() {
        assert_eq!(numbers("0-2,5\n"), Some(vec![0, 1, 2, 5]));
        assert_eq!(numbers("7"), Some(vec![7]));
        assert_eq!(numbers("\n"), Some(vec![]));
    }

    #[test]
    fn what_is_no_list() {
        for text in ["a", "1-", "-1", "3-1", "0-99999999999", "1-70000", "0-1:1/2"] {
            assert_eq!(numbers(text), None, "{text}");
        }
    }
}
