//! Which partitions get their memory in huge pages.
//!
//! A guest's address goes through two sets of tables, its own and KVM's, and KVM's are as deep as the
//! pages of the host are small. With huge pages a table is shallower, more of it stays in the processor, and
//! a guest that touches memory for the first time leaves itself once for each huge page, not for each of
//! 512 small ones.
//!
//! They are those that the host's owner has set aside (hugetlb). What the kernel makes by itself (THP) is no choice:
//! a PREEMPT_RT kernel has none, and one that has some joins and splits pages while guests run.
//!
//! Partitions that require them are served first, then those that take what is left, each in the order of the file.
//! What is given out here can be gone when it is mapped; that is an error like any other want of memory.

use takt_host::huge_pages::{self, Pool};
use thiserror::Error;

use crate::appliance::Role;
use crate::config::{Bytes, HugePageSize, HugePages, Partition};
use crate::memory::Pages;

/// A partition cannot have the huge pages that it asks for.
#[derive(Debug, PartialEq, Eq, Error)]
pub enum HugePageError {
    /// There are too few.
    #[error(
        "partition {partition}: its memory takes {wanted} huge pages of {size}, and of the host's {total} only {free} are free; set {needed} aside: echo {needed} > {}/nr_hugepages, or at the host's start {} on the kernel's command line; or give the partition huge_pages = \"none\"",
        folder(*size), parameters(*size, *needed)
    )]
    TooFew {
        /// Its name.
        partition: String,
        /// Which pages.
        size: HugePageSize,
        /// How many it takes.
        wanted: u64,
        /// How many are left for it.
        free: u64,
        /// How many there are.
        total: u64,
        /// How many there would have to be.
        needed: u64,
    },
    /// There are none of that size.
    #[error(
        "partition {partition}: this host has no huge pages of {size}: {} is not there; take another size, or huge_pages = \"none\"",
        folder(*size)
    )]
    NoSuchSize {
        /// Its name.
        partition: String,
        /// Which pages.
        size: HugePageSize,
    },
}

fn folder(size: HugePageSize) -> String {
    huge_pages::folder(size.bytes())
}

/// `Documentation/admin-guide/kernel-parameters.txt`, in its units.
fn parameters(size: HugePageSize, count: u64) -> String {
    let name = match size {
        HugePageSize::TwoMiB => "2M",
        HugePageSize::OneGiB => "1G",
    };
    format!("hugepagesz={name} hugepages={count}")
}

/// What a partition asks for.
struct Asked<'a> {
    partition: &'a str,
    memory: u64,
    pages: HugePages,
}

/// The pages of each partition's memory, in their order.
///
/// # Errors
/// See [`HugePageError`].
pub fn choose(partitions: &[Partition], role: Role) -> Result<Vec<Pages>, HugePageError> {
    let asked: Vec<Asked<'_>> = partitions
        .iter()
        .map(|partition| Asked {
            partition: partition.name(),
            memory: partition.memory_bytes(),
            pages: partition.hardware().huge_pages,
        })
        .collect();
    if role == Role::Run {
        set_aside(&asked);
    }
    choose_from(&asked, |size| huge_pages::pool(size.bytes()))
}

/// The appliance has no other program that would do it, or would use the memory. What cannot be set
/// aside is missing later, and told then.
fn set_aside(asked: &[Asked<'_>]) {
    for size in HugePageSize::ALL {
        let of_this = |asked: &&Asked<'_>| size_of(asked) == Some(size);
        let count: u64 = asked.iter().filter(of_this).map(|a| a.memory / size.bytes()).sum();
        if count > 0 {
            let _ = std::fs::write(format!("{}/nr_hugepages", folder(size)), count.to_string());
        }
    }
}

/// Which huge pages would do; `None` if none are wanted, or the memory is not a whole number of them.
fn size_of(asked: &Asked<'_>) -> Option<HugePageSize> {
    match asked.pages {
        HugePages::None => None,
        HugePages::Of(size) => Some(size),
        HugePages::Auto => {
            Some(HugePageSize::TwoMiB).filter(|size| asked.memory.is_multiple_of(size.bytes()))
        }
    }
}

fn choose_from(
    asked: &[Asked<'_>],
    pool: impl Fn(HugePageSize) -> Option<Pool>,
) -> Result<Vec<Pages>, HugePageError> {
    let mut pools = HugePageSize::ALL.map(|size| (size, pool(size)));
    let mut chosen = vec![Pages::Small; asked.len()];
    let insists = |a: &Asked<'_>| matches!(a.pages, HugePages::Of(_));
    for first in [true, false] {
        let turn = asked.iter().zip(&mut chosen).filter(|(a, _)| insists(a) == first);
        for (asked, chosen) in turn {
            let Some(size) = size_of(asked) else { continue };
            let wanted = asked.memory / size.bytes();
            let pool = pools.iter_mut().find(|(of, _)| *of == size).map(|(_, pool)| pool);
            match pool {
                Some(Some(pool)) if wanted <= pool.free => {
                    pool.free -= wanted;
                    *chosen = Pages::Huge(size);
                }
                _ if !first => {}
                Some(Some(Pool { total, free })) => {
                    let (free, total) = (*free, *total);
                    return Err(HugePageError::TooFew {
                        partition: asked.partition.to_owned(),
                        size,
                        wanted,
                        free,
                        total,
                        needed: total + (wanted - free),
                    });
                }
                _ => {
                    let partition = asked.partition.to_owned();
                    return Err(HugePageError::NoSuchSize { partition, size });
                }
            }
        }
    }
    Ok(chosen)
}

/// What people are told of a partition that has huge pages; `None` if it has none.
#[must_use]
pub fn told(partition: &Partition, pages: Pages) -> Option<String> {
    let Pages::Huge(size) = pages else { return None };
    let (memory, count) = (partition.memory_bytes(), partition.memory_bytes() / size.bytes());
    let s = if count == 1 { "" } else { "s" };
    Some(format!("{}: {} in {count} huge page{s} of {size}", partition.name(), Bytes(memory)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;
    const TWO: HugePages = HugePages::Of(HugePageSize::TwoMiB);
    const ONE_GIB: HugePages = HugePages::Of(HugePageSize::OneGiB);
    const HUGE: Pages = Pages::Huge(HugePageSize::TwoMiB);

    fn asked(partition: &str, mib: u64, pages: HugePages) -> Asked<'_> {
        Asked { partition, memory: mib * MIB, pages }
    }

    /// Of a host with so many free pages of 2 MiB, of 40, and none of 1 GiB.
    fn with(free: u64, asked: &[Asked<'_>]) -> Result<Vec<Pages>, HugePageError> {
        choose_from(asked, |size| match size {
            HugePageSize::TwoMiB => Some(Pool { total: 40, free }),
            HugePageSize::OneGiB => None,
        })
    }

    #[test]
    fn who_insists_is_served_before_who_takes_what_is_left() {
        let all = [
            asked("linux", 64, HugePages::Auto),
            asked("plc", 8, TWO),
            asked("other", 4, HugePages::None),
        ];
        assert_eq!(with(36, &all).unwrap(), [HUGE, HUGE, Pages::Small]);
        // For both there are too few, and the first in the file goes without.
        assert_eq!(with(35, &all).unwrap(), [Pages::Small, HUGE, Pages::Small]);
        assert_eq!(with(4, &all).unwrap(), [Pages::Small, HUGE, Pages::Small]);
    }

    #[test]
    fn too_few_are_refused_with_the_number_that_would_do() {
        let all = [asked("one", 8, TWO), asked("two", 6, TWO)];
        let error = with(5, &all).unwrap_err();
        let expected = HugePageError::TooFew {
            partition: "two".into(),
            size: HugePageSize::TwoMiB,
            wanted: 3,
            free: 1,
            total: 40,
            needed: 42,
        };
        assert_eq!(error, expected);
        let text = error.to_string();
        let remedy = "echo 42 > /sys/kernel/mm/hugepages/hugepages-2048kB/nr_hugepages";
        assert!(text.contains(remedy) && text.contains("hugepagesz=2M hugepages=42"), "{text}");
        // With as many as it says there are enough.
        assert!(with(7, &all).is_ok());
    }

    #[test]
    fn a_size_that_the_host_lacks_is_refused() {
        let error = with(40, &[asked("linux", 1024, ONE_GIB)]).unwrap_err().to_string();
        assert!(error.contains("hugepages-1048576kB is not there"), "{error}");
    }

    #[test]
    fn memory_that_is_no_whole_number_of_huge_pages_does_without_unless_it_insists() {
        assert_eq!(with(40, &[asked("linux", 65, HugePages::Auto)]).unwrap(), [Pages::Small]);
        let none = choose_from(&[asked("linux", 64, HugePages::Auto)], |_| None);
        assert_eq!(none.unwrap(), [Pages::Small]);
    }
}
