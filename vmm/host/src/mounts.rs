//! Where the host has its cgroups, and whether cpusets can be made there.
//!
//! A host may have cgroup v2, v1, or both, and a controller belongs to one of them only. The mount
//! point is a convention, not a rule, so the kernel is asked (`proc_pid_mountinfo(5)`).

use std::ffi::OsString;
use std::fs;
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

use thiserror::Error;

const MOUNTS: &str = "proc/self/mountinfo";

/// There is no place for a cpuset.
#[derive(Debug, Error)]
pub enum HierarchyError {
    /// The list of mounts cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// Nothing is mounted.
    #[error(
        "no cgroup2 file system is mounted: mount -t cgroup2 none /sys/fs/cgroup, or if only one CPU has windows, set it apart by hand with the kernel parameter isolcpus=domain,managed_irq,N"
    )]
    NotMounted,
    /// cgroup v1 has the controller.
    #[error(
        "the cpuset controller belongs to cgroup v1 here: start the host with cgroup_no_v1=cpuset (under systemd: systemd.unified_cgroup_hierarchy=1), or if only one CPU has windows, set it apart by hand with the kernel parameter isolcpus=domain,managed_irq,N"
    )]
    Version1,
    /// The kernel has no such controller.
    #[error(
        "the kernel has no cpuset controller (CONFIG_CPUSETS, or cgroup_disable=cpuset was given): if only one CPU has windows, set it apart by hand with the kernel parameter isolcpus=domain,managed_irq,N"
    )]
    NoController,
    /// Takt sees only a part of the hierarchy.
    #[error(
        "{path} is not the root of the host's cgroups: Takt runs in a container, and only the host can set a CPU apart"
    )]
    NotTheRoot {
        /// What is mounted.
        path: PathBuf,
    },
    /// Another Takt has set CPUs apart.
    #[error("another takt has set CPUs apart below {path}: end it first")]
    Locked {
        /// The root of the hierarchy.
        path: PathBuf,
    },
}

/// The root of the cgroup v2 hierarchy, where cpusets can be made.
///
/// # Errors
/// See [`HierarchyError`].
pub fn find() -> Result<PathBuf, HierarchyError> {
    find_below(Path::new("/"))
}

/// As [`find`], of a host whose files lie below `top`, as those of a record do.
///
/// # Errors
/// See [`HierarchyError`].
pub fn find_below(top: &Path) -> Result<PathBuf, HierarchyError> {
    let mounts = read(&top.join(MOUNTS))?;
    let version_1 = has_version_1_cpuset(&mounts);
    let root = cgroup2(&mounts).ok_or(if version_1 {
        HierarchyError::Version1
    } else {
        HierarchyError::NotMounted
    })?;
    let root = top.join(root.strip_prefix("/").unwrap_or(&root));
    // Every cgroup has this file, except the real root (cgroup-v2.rst, "cgroup.type").
    if root.join("cgroup.type").exists() {
        return Err(HierarchyError::NotTheRoot { path: root });
    }
    let controllers = read(&root.join("cgroup.controllers"))?;
    match controllers.split_whitespace().any(|name| name == "cpuset") {
        true => Ok(root),
        false if version_1 => Err(HierarchyError::Version1),
        false => Err(HierarchyError::NoController),
    }
}

fn read(path: &Path) -> Result<String, HierarchyError> {
    fs::read_to_string(path).map_err(|source| HierarchyError::Read { path: path.into(), source })
}

/// Fields of one line: `ID PARENT DEVICE ROOT MOUNT-POINT OPTIONS [TAG...] - TYPE SOURCE OPTIONS`.
struct Mount<'a> {
    root: &'a str,
    point: &'a str,
    kind: &'a str,
    options: &'a str,
}

fn mounts(text: &str) -> impl Iterator<Item = Mount<'_>> {
    text.lines().filter_map(|line| {
        let (place, what) = line.split_once(" - ")?;
        let mut place = place.split(' ').skip(3);
        let mut what = what.split(' ');
        Some(Mount {
            root: place.next()?,
            point: place.next()?,
            kind: what.next()?,
            options: what.nth(1)?,
        })
    })
}

fn cgroup2(text: &str) -> Option<PathBuf> {
    mounts(text).find(|m| m.kind == "cgroup2" && m.root == "/").map(|m| unescape(m.point))
}

/// Where the resctrl file system is mounted, and its own options.
pub(crate) fn resctrl(text: &str) -> Option<(PathBuf, String)> {
    mounts(text)
        .find(|m| m.kind == "resctrl" && m.root == "/")
        .map(|m| (unescape(m.point), m.options.to_owned()))
}

fn has_version_1_cpuset(text: &str) -> bool {
    mounts(text).any(|m| m.kind == "cgroup" && m.options.split(',').any(|o| o == "cpuset"))
}

/// A path as it is; blanks and the like are given as a backslash and three octal digits.
fn unescape(text: &str) -> PathBuf {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let [first, tail @ ..] = rest {
        let code = tail.get(..3).and_then(|digits| str::from_utf8(digits).ok());
        match code.and_then(|digits| u8::from_str_radix(digits, 8).ok()) {
            Some(byte) if *first == b'\\' => {
                bytes.push(byte);
                rest = &tail[3..];
            }
            _ => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    OsString::from_vec(bytes).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIFIED: &str = "\
23 1 0:21 / /proc rw,relatime shared:5 - proc proc rw
31 23 0:26 / /sys/fs/cgroup rw,nosuid shared:9 - cgroup2 cgroup2 rw,nsdelegate
";
    const HYBRID: &str = "\
34 31 0:31 / /sys/fs/cgroup/cpuset rw,relatime - cgroup cgroup rw,cpuset
41 31 0:38 / /sys/fs/cgroup/unified\\040two rw,relatime - cgroup2 cgroup2 rw
";

    #[test]
    fn the_hierarchy_is_found_wherever_it_is_mounted() {
        assert_eq!(cgroup2(UNIFIED), Some("/sys/fs/cgroup".into()));
        assert_eq!(cgroup2(HYBRID), Some("/sys/fs/cgroup/unified two".into()));
        assert_eq!((has_version_1_cpuset(UNIFIED), has_version_1_cpuset(HYBRID)), (false, true));
    }

    #[test]
    fn a_part_of_the_hierarchy_is_not_the_hierarchy() {
        let bound = UNIFIED.replace("0:26 / ", "0:26 /docker/1 ");
        assert_eq!(cgroup2(&bound), None);
    }

    #[test]
    fn broken_lines_are_passed_over() {
        assert_eq!(cgroup2("\n - \n1 2 - cgroup2\n31 23 0:26 / - cgroup2 x y\n"), None);
        assert_eq!(unescape("a\\04"), PathBuf::from("a\\04"));
    }
}
