//! Leaving the file system (landlock(7)).
//!
//! What is open stays usable. Files can be opened, made or removed only beneath the paths
//! that are allowed. Landlock is the kernel's own, needs no privilege, and holds for one thread and
//! those that it starts.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;

use super::privileges;

/// Rights on files, of `include/uapi/linux/landlock.h`.
mod right {
    pub const WRITE_FILE: u64 = 1 << 1;
    pub const READ_FILE: u64 = 1 << 2;
    pub const READ_DIR: u64 = 1 << 3;
    pub const REMOVE_DIR: u64 = 1 << 4;
    pub const REMOVE_FILE: u64 = 1 << 5;
    /// Those of the first version.
    pub const FIRST: u64 = (1 << 13) - 1;
    /// Since version 2.
    pub const REFER: u64 = 1 << 13;
    /// Since version 3.
    pub const TRUNCATE: u64 = 1 << 14;
}

/// What a thread may still do, beneath a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Allowed {
    /// Read.
    Read(PathBuf),
    /// Write a file that is there.
    Write(PathBuf),
    /// Read and write files that are there: a PCI function that is given back, or its driver.
    GiveBack(PathBuf),
    /// The same, and remove folders: cgroups.
    WriteAndRemoveFolders(PathBuf),
    /// Remove files.
    RemoveFiles(PathBuf),
}

impl Allowed {
    /// Which capability it cannot be done without, as a bit.
    #[must_use]
    pub const fn capability(&self) -> u32 {
        match self {
            Allowed::GiveBack(_) => privileges::SYS_ADMIN,
            Allowed::WriteAndRemoveFolders(_) => privileges::DAC_OVERRIDE,
            Allowed::Read(_) | Allowed::Write(_) | Allowed::RemoveFiles(_) => 0,
        }
    }

    fn parts(&self) -> (&PathBuf, u64) {
        let write = right::READ_FILE | right::WRITE_FILE | right::TRUNCATE;
        match self {
            Allowed::Read(path) => (path, right::READ_FILE | right::READ_DIR),
            Allowed::Write(path) => (path, right::WRITE_FILE | right::TRUNCATE),
            Allowed::GiveBack(path) => (path, write),
            Allowed::WriteAndRemoveFolders(path) => (path, write | right::REMOVE_DIR),
            Allowed::RemoveFiles(path) => (path, right::REMOVE_FILE),
        }
    }
}

/// `struct landlock_path_beneath_attr`, which is packed.
#[repr(C, packed)]
struct PathBeneath {
    allowed: u64,
    parent: i32,
}

/// Takes all of the file system from the calling thread but what is allowed; false if this kernel
/// has no Landlock, or has it switched off. It must not be able to gain privileges.
///
/// # Errors
/// What the kernel says, also of a path that is not there.
pub fn restrict(allowed: &[Allowed]) -> io::Result<bool> {
    /// Asks for the version instead of making anything.
    const VERSION: u32 = 1;
    /// `LANDLOCK_RULE_PATH_BENEATH`.
    const PATH_BENEATH: u32 = 1;

    // SAFETY: asks for a number; there is nothing to read.
    let version = unsafe {
        libc::syscall(libc::SYS_landlock_create_ruleset, std::ptr::null::<u64>(), 0usize, VERSION)
    };
    if version < 0 {
        let error = io::Error::last_os_error();
        return match error.raw_os_error() {
            Some(libc::ENOSYS | libc::EOPNOTSUPP) => Ok(false),
            _ => Err(error),
        };
    }
    let handled = match version {
        1 => right::FIRST,
        2 => right::FIRST | right::REFER,
        _ => right::FIRST | right::REFER | right::TRUNCATE,
    };
    // SAFETY: the kernel reads the live integer, which is the whole of the structure's first version.
    let ruleset = check(unsafe {
        let size = size_of_val(&handled);
        libc::syscall(libc::SYS_landlock_create_ruleset, &raw const handled, size, 0u32)
    })?;
    // SAFETY: the descriptor is new and has no other owner. It is small, as all descriptors are.
    let ruleset = unsafe { OwnedFd::from_raw_fd(ruleset as i32) };
    for (path, rights) in allowed.iter().map(Allowed::parts) {
        let folder: File = OpenOptions::new().read(true).custom_flags(libc::O_PATH).open(path)?;
        let beneath = PathBeneath { allowed: rights & handled, parent: folder.as_raw_fd() };
        // SAFETY: the kernel reads the live structure.
        check(unsafe {
            let rule = &raw const beneath;
            let ruleset = ruleset.as_raw_fd();
            libc::syscall(libc::SYS_landlock_add_rule, ruleset, PATH_BENEATH, rule, 0u32)
        })?;
    }
    // SAFETY: takes integers only.
    check(unsafe { libc::syscall(libc::SYS_landlock_restrict_self, ruleset.as_raw_fd(), 0u32) })?;
    Ok(true)
}

fn check(result: libc::c_long) -> io::Result<libc::c_long> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn only_what_is_allowed_can_be_reached() {
        let folder = std::env::temp_dir().join(format!("takt-landlock-{}", std::process::id()));
        let [open, shut] = ["open", "shut"].map(|name| folder.join(name));
        for path in [&open, &shut] {
            fs::create_dir_all(path).unwrap();
            fs::write(path.join("file"), "text").unwrap();
        }
        let mut kept = File::open(shut.join("file")).unwrap();
        let inside = (open.clone(), shut.clone());
        // Landlock holds for the thread that asks for it.
        let restricted = std::thread::spawn(move || {
            let (open, shut) = inside;
            super::super::privileges::no_new_privileges().unwrap();
            if !restrict(&[Allowed::Read(open.clone())]).unwrap() {
                return false;
            }
            assert_eq!(fs::read_to_string(open.join("file")).unwrap(), "text");
            let denied = [
                fs::read_to_string(shut.join("file")).map(drop),
                fs::write(open.join("file"), ""),
                fs::remove_file(open.join("file")),
                fs::read_dir("/").map(drop),
                File::open("/proc/self/mem").map(drop),
            ];
            for (number, result) in denied.into_iter().enumerate() {
                let kind = result.unwrap_err().kind();
                assert_eq!(kind, io::ErrorKind::PermissionDenied, "{number}");
            }
            // What is open stays open.
            let mut text = String::new();
            io::Read::read_to_string(&mut kept, &mut text).unwrap();
            assert_eq!(text, "text");
            true
        });
        if !restricted.join().unwrap() {
            eprintln!("skipped: this kernel has no Landlock");
        }
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error() {
        let restricted = std::thread::spawn(|| {
            super::super::privileges::no_new_privileges().unwrap();
            restrict(&[Allowed::GiveBack("/no/such/folder".into())])
        });
        match restricted.join().unwrap() {
            Ok(false) => eprintln!("skipped: this kernel has no Landlock"),
            result => assert_eq!(result.unwrap_err().kind(), io::ErrorKind::NotFound),
        }
    }
}
