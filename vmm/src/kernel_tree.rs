//! A tree of folders that the kernel makes of its own objects: cgroups, and the groups of resctrl.
//!
//! In both, a folder is a group, a file is a setting, and one Takt at a time may change them. What the
//! files mean is for [`cpuset`](crate::cpuset) and [`resctrl`](crate::resctrl) to know.
//!
//! It is a trait, because what matters to both is the order of their steps and what happens when one is
//! refused, and a test must be able to refuse any of them.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Such a tree. Paths are relative to its root, with `""` for it.
pub trait Tree {
    /// What a file says.
    fn read(&self, path: &str) -> io::Result<String>;
    /// Writes a line to a file that is there.
    fn write(&self, path: &str, line: &str) -> io::Result<()>;
    /// Makes a group.
    fn make(&self, path: &str) -> io::Result<()>;
    /// Removes a group.
    fn remove(&self, path: &str) -> io::Result<()>;
    /// For error texts, and for threads to enter.
    fn full_path(&self, path: &str) -> PathBuf;
}

/// A tree of the host, locked while this value lives. Two processes that both find, change and take
/// back what they share could not know what is whose.
pub struct LockedTree {
    root: PathBuf,
    _lock: File,
}

impl LockedTree {
    /// The tree below this folder, kept from other Takts.
    ///
    /// # Errors
    /// [`TryLockError::WouldBlock`] if another Takt has it, or that the folder cannot be opened.
    pub fn open(root: PathBuf) -> Result<Self, TryLockError> {
        let lock = File::open(&root).map_err(TryLockError::Error)?;
        lock.try_lock()?;
        Ok(Self { root, _lock: lock })
    }
}

impl Tree for LockedTree {
    fn read(&self, path: &str) -> io::Result<String> {
        fs::read_to_string(self.full_path(path))
    }

    fn write(&self, path: &str, line: &str) -> io::Result<()> {
        write_line(&self.full_path(path), line)
    }

    fn make(&self, path: &str) -> io::Result<()> {
        fs::create_dir(self.full_path(path))
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        fs::remove_dir(self.full_path(path))
    }

    fn full_path(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }
}

/// Writes a whole line, as resctrl wants it and cgroups allow. The file is not made: of a missing one the
/// kernel then says that it is missing.
pub fn write_line(path: &Path, line: &str) -> io::Result<()> {
    OpenOptions::new().write(true).open(path)?.write_all(format!("{line}\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_takt_finds_the_tree_locked_and_no_file_is_made_by_a_write() {
        let root = std::env::temp_dir().join(format!("takt-kernel-tree-{}", std::process::id()));
        fs::create_dir_all(&root).unwrap();
        let tree = LockedTree::open(root.clone()).unwrap();
        assert!(matches!(LockedTree::open(root.clone()), Err(TryLockError::WouldBlock)));
        tree.make("group").unwrap();
        let missing = tree.write("group/tasks", "0").unwrap_err();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        fs::write(root.join("group/tasks"), "").unwrap();
        tree.write("group/tasks", "0").unwrap();
        assert_eq!(tree.read("group/tasks").unwrap(), "0\n");
        assert!(tree.remove("group").is_err(), "it has a file, and is no group of a kernel");
        drop(tree);
        assert!(LockedTree::open(root.clone()).is_ok());
        fs::remove_dir_all(&root).unwrap();
    }
}
