//! How the host divides its last-level cache and the way to memory: the kernel's resctrl file system
//! (`Documentation/filesystems/resctrl.rst`).
//!
//! ```text
//!  /sys/fs/resctrl     the default group: all threads that are in no other; schemata, tasks
//!   +-- info/L3, MB    what the processor can divide, and how finely
//!   +-- takt-linux     a group: what its threads may use of it
//! ```
//!
//! Here it is only read: by Takt, which then makes groups ([`plan`] says which), and by the doctor, which tells
//! beforehand what Takt will meet.

mod plan;
mod schemata;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use takt_scheduler::table::Cpu;
use thiserror::Error;

pub use plan::{Asked, Group, Plan, plan};
pub use schemata::{Resource, Schemata};

/// What the names of Takt's groups begin with.
pub const PREFIX: &str = "takt-";
/// Folders of the file system that are no groups.
const NO_GROUPS: [&str; 3] = ["info", "mon_groups", "mon_data"];

/// What is asked for cannot be had.
#[derive(Debug, Error)]
pub enum ResctrlError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the kernel said, or that it makes no sense.
        source: io::Error,
    },
    /// The processor or the kernel cannot divide anything.
    #[error(
        "this host cannot divide its cache or the way to memory (no resctrl in /proc/filesystems)"
    )]
    NotSupported,
    /// The file system is not mounted.
    #[error("the resctrl file system is not mounted")]
    NotMounted,
    /// Code and data are divided apart.
    #[error(
        "the resctrl file system is mounted with `cdp`, by which code and data are divided apart"
    )]
    Cdp,
    /// Bandwidth is counted, not divided.
    #[error(
        "the resctrl file system is mounted with `mba_MBps`, by which bandwidth is no percentage"
    )]
    MegaBytes,
    /// The cache cannot be divided.
    #[error("partition {partition}: this host cannot divide its L3 cache (no info/L3)")]
    NoCache {
        /// Who asks for it.
        partition: String,
    },
    /// Bandwidth cannot be divided.
    #[error("partition {partition}: this host cannot divide memory bandwidth (no info/MB)")]
    NoBandwidth {
        /// Who asks for it.
        partition: String,
    },
    /// AMD counts bandwidth in eighths of a GB/s.
    #[error(
        "partition {partition}: AMD's processors have memory bandwidth in eighths of a GB/s, and no percentage"
    )]
    Absolute {
        /// Who asks for it.
        partition: String,
    },
    /// The CPU has no such cache.
    #[error("partition {partition}: the kernel does not tell which L3 cache CPU {cpu} has", cpu = cpu.0)]
    NoDomain {
        /// Who asks for it.
        partition: String,
        /// Its CPU.
        cpu: Cpu,
    },
    /// Too few ways for one partition.
    #[error(
        "partition {partition}: {ways} ways of the L3 cache, and the processor divides off {least} at least"
    )]
    TooFewWays {
        /// Who asks for it.
        partition: String,
        /// For how many.
        ways: u32,
        /// How many it has to be.
        least: u32,
    },
    /// Too many ways for all.
    #[error(
        "partitions ask for {wanted} ways of L3 cache {domain}, which has {all}; {least} at least are for all the rest, Takt and the kernel among it"
    )]
    TooManyWays {
        /// Which cache.
        domain: u32,
        /// How many ways it has.
        all: u32,
        /// How many are asked for.
        wanted: u32,
        /// How many are left at least.
        least: u32,
    },
    /// Devices use the same ways.
    #[error(
        "{wanted} ways of L3 cache {domain} cannot be kept from devices, which use the ways {shared:#x} of {all:#x}"
    )]
    Shared {
        /// Which cache.
        domain: u32,
        /// How many are asked for.
        wanted: u32,
        /// Those that devices use.
        shared: u32,
        /// All ways.
        all: u32,
    },
    /// Another group uses them.
    #[error(
        "group {group} of the resctrl file system uses ways of L3 cache {domain} that Takt needs"
    )]
    Taken {
        /// Its name.
        group: String,
        /// Which cache.
        domain: u32,
    },
    /// The default group does not have the whole cache.
    #[error(
        "L3 cache {domain} is divided already: its default group has the ways {has:#x} of {all:#x}"
    )]
    Divided {
        /// Which cache.
        domain: u32,
        /// What it has.
        has: u32,
        /// All ways.
        all: u32,
    },
    /// A percentage that the processor does not have.
    #[error(
        "partition {partition}: {percent} % of the memory bandwidth, and the processor has steps of {step} % from {least} % on"
    )]
    Percentage {
        /// Who asks for it.
        partition: String,
        /// For how much.
        percent: u32,
        /// The steps.
        step: u32,
        /// The least.
        least: u32,
    },
    /// No group is left.
    #[error(
        "the processor tells {all} groups apart; {there} are there, and Takt needs {wanted} more"
    )]
    TooManyGroups {
        /// How many there can be.
        all: u32,
        /// How many there are, the default group among them.
        there: u32,
        /// How many are needed.
        wanted: u32,
    },
}

impl ResctrlError {
    /// What mends it.
    #[must_use]
    pub fn remedy(&self) -> String {
        const WITHOUT: &str = "leave `cache` and `memory_bandwidth` out of the partition file";
        match self {
            Self::Read { .. } => "run as root; is the kernel's file system whole?".into(),
            Self::NotSupported => format!(
                "take a processor with L3 CAT or MBA (flags cat_l3 and mba in /proc/cpuinfo), or {WITHOUT}"
            ),
            Self::NotMounted => "mount -t resctrl resctrl /sys/fs/resctrl".into(),
            Self::Cdp | Self::MegaBytes => {
                "umount /sys/fs/resctrl; mount -t resctrl resctrl /sys/fs/resctrl".into()
            }
            Self::NoCache { .. } | Self::NoDomain { .. } => "leave `cache` out".into(),
            Self::NoBandwidth { .. } | Self::Absolute { .. } => {
                "leave `memory_bandwidth` out".into()
            }
            Self::TooFewWays { least, .. } => format!("cache = {least}, or more"),
            Self::TooManyWays { all, least, .. } => {
                format!("at most {} ways for all partitions together", all.saturating_sub(*least))
            }
            Self::Shared { shared, all, .. } => {
                format!("at most {} ways for all partitions together", (all & !shared).count_ones())
            }
            Self::Taken { group, .. } => {
                format!("rmdir the group {group}, or give its schemata other ways")
            }
            Self::Divided { domain, all, .. } => {
                format!("echo L3:{domain}={all:x} > /sys/fs/resctrl/schemata")
            }
            Self::Percentage { percent, step, least, .. } => {
                let down = percent - percent % (*step).max(1);
                format!("memory_bandwidth = {}", down.max(*least))
            }
            Self::TooManyGroups { .. } => {
                "rmdir groups that are not needed, or give fewer partitions `cache` and `memory_bandwidth`".into()
            }
        }
    }
}

/// What the processor can divide, and how finely.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Info {
    /// The L3 cache.
    pub cache: Option<CacheInfo>,
    /// The way to memory.
    pub bandwidth: Option<BandwidthInfo>,
    /// Whether bandwidth is counted in eighths of a GB/s.
    pub absolute: bool,
}

/// How the L3 cache can be divided. A way is a bit of a mask, and a mask has its bits in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheInfo {
    /// Groups, the default one among them.
    pub groups: u32,
    /// All ways.
    pub all: u32,
    /// Least number of ways of a group.
    pub least: u32,
    /// Ways that devices use too.
    pub shared: u32,
}

/// How memory bandwidth can be divided, in per cent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BandwidthInfo {
    /// Groups, the default one among them.
    pub groups: u32,
    /// The least.
    pub least: u32,
    /// The steps.
    pub step: u32,
}

/// Where the file system is mounted.
///
/// # Errors
/// See [`ResctrlError`].
pub fn find() -> Result<PathBuf, ResctrlError> {
    find_below(Path::new("/"))
}

/// As [`find`], of a host whose files lie below `top`, as those of a record do.
///
/// # Errors
/// See [`ResctrlError`].
pub fn find_below(top: &Path) -> Result<PathBuf, ResctrlError> {
    let mounts = read(&top.join("proc/self/mountinfo"))?;
    if let Some((point, options)) = super::mounts::resctrl(&mounts) {
        let has = |name: &str| options.split(',').any(|option| option == name);
        if has("mba_MBps") {
            return Err(ResctrlError::MegaBytes);
        }
        if has("cdp") {
            return Err(ResctrlError::Cdp);
        }
        return Ok(top.join(point.strip_prefix("/").unwrap_or(&point)));
    }
    let known = read(&top.join("proc/filesystems"))?;
    match known.split_whitespace().any(|name| name == "resctrl") {
        true => Err(ResctrlError::NotMounted),
        false => Err(ResctrlError::NotSupported),
    }
}

/// What the processor can divide, by `read`, which gives a file's text by its path below the file system's
/// root.
///
/// # Errors
/// [`ResctrlError::Read`] of a file that makes no sense. One that is not there is something that the
/// processor cannot do.
pub fn info(vendor: &str, read: impl Fn(&str) -> io::Result<String>) -> Result<Info, ResctrlError> {
    let number = |path: &str, radix| -> Result<Option<u32>, ResctrlError> {
        let text = match read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(|source| ResctrlError::Read { path: path.into(), source })?,
        };
        let nonsense = || io::Error::other(format!("{:?} is no number", text.trim()));
        u32::from_str_radix(text.trim(), radix)
            .map(Some)
            .map_err(|_| ResctrlError::Read { path: path.into(), source: nonsense() })
    };
    let cache = match (number("info/L3/num_closids", 10)?, number("info/L3/cbm_mask", 16)?) {
        (Some(groups), Some(all)) => Some(CacheInfo {
            groups,
            all,
            least: number("info/L3/min_cbm_bits", 10)?.unwrap_or(1).max(1),
            shared: number("info/L3/shareable_bits", 16)?.unwrap_or(0),
        }),
        _ => None,
    };
    let bandwidth = match (number("info/MB/num_closids", 10)?, number("info/MB/min_bandwidth", 10)?)
    {
        (Some(groups), Some(least)) => Some(BandwidthInfo {
            groups,
            least,
            step: number("info/MB/bandwidth_gran", 10)?.unwrap_or(1).max(1),
        }),
        _ => None,
    };
    Ok(Info { cache, bandwidth, absolute: ["AuthenticAMD", "HygonGenuine"].contains(&vendor) })
}

/// Which L3 cache a CPU has, by the kernel's number, which schemata have too. Memory bandwidth is
/// divided by the same.
#[must_use]
pub fn domain_below(top: &Path, Cpu(cpu): Cpu) -> Option<u32> {
    let folder = top.join(format!("sys/devices/system/cpu/cpu{cpu}/cache"));
    let number = |path: PathBuf| fs::read_to_string(path).ok()?.trim().parse::<u32>().ok();
    let caches = (0..8).map(|index| folder.join(format!("index{index}")));
    let third = caches.into_iter().find(|cache| number(cache.join("level")) == Some(3))?;
    number(third.join("id"))
}

/// Who made the processor, in its own words.
#[must_use]
pub fn vendor_below(top: &Path) -> String {
    let text = fs::read_to_string(top.join("proc/cpuinfo")).unwrap_or_default();
    let lines = text.lines().filter_map(|line| line.split_once(':'));
    let vendor = lines.into_iter().find(|(name, _)| name.trim() == "vendor_id");
    vendor.map_or(String::new(), |(_, value)| value.trim().to_owned())
}

/// Whether a folder of the root is a group.
#[must_use]
pub fn is_group(name: &str) -> bool {
    !NO_GROUPS.contains(&name)
}

fn read(path: &Path) -> Result<String, ResctrlError> {
    fs::read_to_string(path).map_err(|source| ResctrlError::Read { path: path.into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(name: &str, mounts: &str, known: &str) -> Result<PathBuf, ResctrlError> {
        let top = std::env::temp_dir().join(format!("takt-resctrl-{name}-{}", std::process::id()));
        fs::create_dir_all(top.join("proc/self")).unwrap();
        fs::write(top.join("proc/self/mountinfo"), mounts).unwrap();
        fs::write(top.join("proc/filesystems"), known).unwrap();
        let found = find_below(&top).map(|path| path.strip_prefix(&top).unwrap().to_owned());
        fs::remove_dir_all(top).unwrap();
        found
    }

    #[test]
    fn a_file_system_that_is_missing_or_mounted_otherwise_is_told_with_the_command() {
        const MOUNTED: &str = "44 31 0:40 / /sys/fs/resctrl rw - resctrl resctrl rw";
        const KNOWN: &str = "nodev\tproc\nnodev\tresctrl\n";
        assert_eq!(host("there", MOUNTED, KNOWN).unwrap(), Path::new("sys/fs/resctrl"));
        let error = |name, mounts: &str, known| host(name, mounts, known).unwrap_err();
        let not_mounted = error("not-mounted", "", KNOWN);
        assert_eq!(not_mounted.remedy(), "mount -t resctrl resctrl /sys/fs/resctrl");
        let none = error("none", "", "nodev\tproc\n");
        assert!(matches!(none, ResctrlError::NotSupported) && none.remedy().contains("cat_l3"));
        let cdp = error("cdp", &format!("{MOUNTED},cdp"), KNOWN);
        assert!(matches!(cdp, ResctrlError::Cdp));
        let mega = error("mega", &format!("{MOUNTED},mba_MBps"), KNOWN);
        assert!(matches!(mega, ResctrlError::MegaBytes));
        // A part of the file system, as in a container, is not the file system.
        let part = error("part", &MOUNTED.replace("0:40 / ", "0:40 /x "), KNOWN);
        assert!(matches!(part, ResctrlError::NotMounted));
    }
}
