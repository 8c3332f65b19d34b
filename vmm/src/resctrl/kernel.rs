//! The few things that are asked of the resctrl file system.
//!
//! They are a trait, because what matters in [`setup`](super::setup) is the order of the steps and what
//! happens when one is refused, and a test must be able to refuse any of them.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use takt_host::resctrl;

use super::GroupError;

/// A resctrl file system. Paths are relative to its root, with `""` for it.
pub trait Kernel {
    /// What a file says.
    fn read(&self, path: &str) -> io::Result<String>;
    /// Writes to a file that is there.
    fn write(&self, path: &str, text: &str) -> io::Result<()>;
    /// Makes a group.
    fn make(&self, path: &str) -> io::Result<()>;
    /// Removes a group; threads that it has go back to the default group.
    fn remove(&self, path: &str) -> io::Result<()>;
    /// The names of all folders of the root.
    fn folders(&self) -> io::Result<Vec<String>>;
    /// Who made the processor.
    fn vendor(&self) -> String;
    /// For error texts, and for threads to enter.
    fn full_path(&self, path: &str) -> PathBuf;
}

/// A group that threads of this process may enter.
#[derive(Clone, Debug)]
pub struct Entry {
    tasks: PathBuf,
}

impl Entry {
    pub(super) fn by(tasks: PathBuf) -> Self {
        Self { tasks }
    }

    /// Moves the calling thread there.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn enter(&self) -> io::Result<()> {
        // 0 is the thread that writes (`rdtgroup_move_task` in arch/x86/kernel/cpu/resctrl/rdtgroup.c).
        overwrite(&self.tasks, "0")
    }
}

/// The host's.
pub struct FileSystem {
    root: PathBuf,
    /// Locked while this value lives, as the kernel's documentation asks of all who change groups.
    _lock: File,
}

impl FileSystem {
    /// At this place, kept from other Takts.
    ///
    /// # Errors
    /// [`GroupError::Locked`], or that it cannot be opened.
    pub fn open(root: PathBuf) -> Result<Self, GroupError> {
        let unreadable =
            |source| GroupError::Step { what: "open", path: root.display().to_string(), source };
        let lock = File::open(&root).map_err(unreadable)?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { root, _lock: lock }),
            Err(fs::TryLockError::WouldBlock) => Err(GroupError::Locked { path: root }),
            Err(fs::TryLockError::Error(source)) => Err(unreadable(source)),
        }
    }
}

impl Kernel for FileSystem {
    fn read(&self, path: &str) -> io::Result<String> {
        fs::read_to_string(self.full_path(path))
    }

    fn write(&self, path: &str, text: &str) -> io::Result<()> {
        overwrite(&self.full_path(path), text)
    }

    fn make(&self, path: &str) -> io::Result<()> {
        fs::create_dir(self.full_path(path))
    }

    fn remove(&self, path: &str) -> io::Result<()> {
        fs::remove_dir(self.full_path(path))
    }

    fn folders(&self) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.root)? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                names.extend(entry.file_name().into_string());
            }
        }
        names.sort();
        Ok(names)
    }

    fn vendor(&self) -> String {
        resctrl::vendor_below(Path::new("/"))
    }

    fn full_path(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }
}

/// The kernel reads whole lines. It makes no file of a name that is not there.
fn overwrite(path: &PathBuf, text: &str) -> io::Result<()> {
    OpenOptions::new().write(true).open(path)?.write_all(format!("{text}\n").as_bytes())
}
