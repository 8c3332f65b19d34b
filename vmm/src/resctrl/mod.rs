//! Cache and memory bandwidth of partitions, divided before a run and whole again after it.
//!
//! The kernel's resctrl file system has groups of threads, and says for each which ways of the L3 cache they may
//! fill and how much of the way to memory they get. Who gets what is a plan
//! ([`takt_host::resctrl`]); here it is written (`setup`), and each thread of a partition enters its group before it
//! is pinned.
//!
//! A Takt that was killed leaves its groups. The next one on this host removes them, whether its file asks for anything
//! or not: their names begin with `takt-`, and they have no threads.
//!
//! None of it has run on hardware that divides anything. It has run on the kernel's file system, in an emulator whose
//! processor only says that it divides (docs/partition-file.md).

mod kernel;
mod setup;

use std::fs::TryLockError;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use takt_host::resctrl::{self, Asked, ResctrlError};
use thiserror::Error;

use crate::config::Partition;
use crate::kernel_tree::LockedTree;
use crate::outlet::last_line;
pub use kernel::Entry;
use setup::Setup;

/// Cache or bandwidth could not be divided.
#[derive(Debug, Error)]
pub enum GroupError {
    /// It cannot be had.
    #[error("cannot divide cache or memory bandwidth: {source}; {}", source.remedy())]
    Refused {
        /// Why not.
        #[from]
        source: ResctrlError,
    },
    /// The kernel refuses a step.
    #[error("cannot {what} {path}: {source}{}", remedy(source))]
    Step {
        /// What was attempted.
        what: &'static str,
        /// On which file or folder.
        path: String,
        /// What the kernel said.
        source: io::Error,
    },
    /// A group of this name has threads.
    #[error(
        "{path} has threads ({threads}): another takt has it, or an administrator; end that first"
    )]
    InUse {
        /// The folder.
        path: String,
        /// Their ids.
        threads: String,
    },
    /// Another Takt is at work.
    #[error("another takt has divided the cache below {}: end it first", path.display())]
    Locked {
        /// The root of the file system.
        path: PathBuf,
    },
    /// Setting up failed, and then undoing what was done of it.
    #[error("{error}; and what was done until then could not be undone: {undo}")]
    AndNotUndone {
        /// Why setting up failed.
        error: Box<GroupError>,
        /// Why undoing failed.
        undo: Box<GroupError>,
    },
}

fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => "; run as root",
        Some(libc::EROFS) => "; in a container, mount the host's resctrl file system writable",
        Some(libc::EINVAL) => "; info/last_cmd_status has the kernel's reason",
        _ => "",
    }
}

/// The host's resctrl file system at this place, kept from other Takts by a lock, as the kernel's
/// documentation asks of all who change groups.
fn open(root: PathBuf) -> Result<LockedTree, GroupError> {
    LockedTree::open(root.clone()).map_err(|error| match error {
        TryLockError::WouldBlock => GroupError::Locked { path: root },
        TryLockError::Error(source) => {
            GroupError::Step { what: "open", path: root.display().to_string(), source }
        }
    })
}

/// The groups of a run. Dropping it removes them.
#[derive(Default)]
pub struct Groups {
    setup: Option<Setup<LockedTree>>,
}

impl Groups {
    /// Makes a group for each partition that asks for one, and tells what it did. Either all of them are
    /// there afterwards, or nothing is changed.
    ///
    /// # Errors
    /// See [`GroupError`].
    pub fn set_up(partitions: &[Partition]) -> Result<Self, GroupError> {
        let asked: Vec<Asked> = partitions.iter().filter_map(asked).collect();
        if asked.is_empty() {
            remove_left_over();
            return Ok(Self::default());
        }
        let setup = Setup::make(open(resctrl::find()?)?, &asked)?;
        for text in setup.told() {
            tell(&text);
        }
        Ok(Self { setup: Some(setup) })
    }

    /// The root of the file system, if anything in it is to be undone.
    #[must_use]
    pub fn root(&self) -> Option<PathBuf> {
        self.setup.as_ref().map(Setup::root)
    }

    /// What a thread of the partition enters; `None` if it stays where it is.
    #[must_use]
    pub fn entry(&self, partition: &Partition) -> Option<Entry> {
        self.setup.as_ref().and_then(|setup| setup.entry(partition.name()))
    }
}

impl Drop for Groups {
    fn drop(&mut self) {
        let Some(setup) = &mut self.setup else { return };
        let text = match setup.undo() {
            Ok(()) => "cache and memory bandwidth are the host's again".to_owned(),
            // The run is over and its report is good: this is told, and its status stays.
            Err(error) => format!(
                "cache and memory bandwidth are not as they were: {error}; the next run of takt removes what is left"
            ),
        };
        last_line(&mut io::stdout(), &text);
    }
}

/// What a killed Takt has left, where this file asks for nothing. If it cannot be removed, the run is not
/// worse off for it than the host is.
fn remove_left_over() {
    let Ok(root) = resctrl::find() else { return };
    let removed = open(root).and_then(|kernel| setup::remove_left_over(&kernel));
    match removed {
        Ok(0) | Err(GroupError::Locked { .. }) => {}
        Ok(count) => tell(&format!("{count} groups of a takt that was killed are removed")),
        Err(error) => tell(&format!("groups of a takt that was killed are left: {error}")),
    }
}

/// What a partition asks for; `None` if it asks for nothing.
fn asked(partition: &Partition) -> Option<Asked> {
    let hardware = partition.hardware();
    let asks = hardware.cache.is_some() || hardware.memory_bandwidth.is_some();
    asks.then(|| Asked {
        partition: partition.name().to_owned(),
        cpu: partition.cpu(),
        domain: resctrl::domain_below(Path::new("/"), partition.cpu()),
        ways: hardware.cache,
        percent: hardware.memory_bandwidth,
    })
}

/// A line to the user, who may have gone.
fn tell(text: &str) {
    let _ = writeln!(io::stdout(), "[takt] {text}");
}
