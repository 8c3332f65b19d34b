//! What resctrl has beside its tree of groups.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use takt_host::resctrl;

use crate::kernel_tree::{LockedTree, Tree, write_line};

/// A resctrl file system. A thread of a group that is removed goes back to the default group.
pub trait Kernel: Tree {
    /// The names of all folders of the root.
    fn folders(&self) -> io::Result<Vec<String>>;
    /// Who made the processor.
    fn vendor(&self) -> String;
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
        write_line(&self.tasks, "0")
    }
}

impl Kernel for LockedTree {
    fn folders(&self) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(self.full_path(""))? {
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
}
