//! The steps that divide the cache, and the same steps back.
//!
//! The order makes sure that a Takt that is killed at any point leaves a group behind where it has left
//! the default group with less than all: groups are made first and removed last. So who finds a group of Takt's
//! without threads knows that the default group is Takt's to make whole, and who finds none leaves it alone.

use std::io;
use std::path::PathBuf;

use takt_host::resctrl::{self, Asked, Group, Info, PREFIX, Plan, Resource, Schemata};

use super::GroupError;
use super::kernel::{Entry, Kernel};

const SCHEMATA: &str = "schemata";

/// A cache that is divided.
pub struct Setup<K: Kernel> {
    kernel: K,
    plan: Plan,
    /// How many of the plan's groups are made.
    made: usize,
    /// Whether the default group has less than all.
    taken: bool,
}

impl<K: Kernel> Setup<K> {
    /// Makes a group for each: all of them, or nothing is changed.
    ///
    /// # Errors
    /// See [`GroupError`].
    pub fn make(kernel: K, asked: &[Asked]) -> Result<Self, GroupError> {
        remove_left_over(&kernel)?;
        let plan = find_plan(&kernel, asked)?;
        let mut this = Self { kernel, plan, made: 0, taken: false };
        match this.build() {
            Ok(()) => Ok(this),
            Err(error) => match this.undo() {
                Ok(()) => Err(error),
                Err(undo) => {
                    Err(GroupError::AndNotUndone { error: error.into(), undo: undo.into() })
                }
            },
        }
    }

    fn build(&mut self) -> Result<(), GroupError> {
        let Self { kernel, plan, made, taken } = self;
        for Group { folder, lines, .. } in &plan.groups {
            kernel.make(folder).map_err(cannot(kernel, "make", folder))?;
            *made += 1;
            write_all(kernel, &format!("{folder}/{SCHEMATA}"), lines)?;
        }
        *taken = true;
        write_all(kernel, SCHEMATA, &plan.taken)
    }

    /// Undoes everything. Goes on after a step that fails, and does nothing the second time.
    ///
    /// # Errors
    /// The first step that failed; all others have been done.
    pub fn undo(&mut self) -> Result<(), GroupError> {
        let mut steps = Vec::new();
        if std::mem::take(&mut self.taken) {
            steps.push(write_all(&self.kernel, SCHEMATA, &self.plan.given_back));
        }
        let made = std::mem::take(&mut self.made);
        for Group { folder, .. } in self.plan.groups.iter().take(made).rev() {
            steps.push(self.kernel.remove(folder).map_err(cannot(&self.kernel, "remove", folder)));
        }
        steps.into_iter().collect()
    }

    /// The root of the file system.
    pub fn root(&self) -> PathBuf {
        self.kernel.full_path("")
    }

    /// How a thread of the partition gets into its group, if it has one.
    pub fn entry(&self, partition: &str) -> Option<Entry> {
        let group = self.plan.groups.iter().find(|group| group.partition == partition)?;
        Some(Entry::by(self.kernel.full_path(&format!("{}/tasks", group.folder))))
    }

    /// What people are told.
    pub fn told(&self) -> impl Iterator<Item = String> {
        let groups = self.plan.groups.iter();
        groups.map(|group| format!("{}'s share: {}", group.partition, group.lines.join(", ")))
    }
}

/// Removes groups that a killed Takt has left, and gives the default group all ways back. Returns how many
/// there were.
///
/// # Errors
/// A group has threads, or the kernel refuses a step.
pub fn remove_left_over(kernel: &impl Kernel) -> Result<usize, GroupError> {
    let folders = kernel.folders().map_err(cannot(kernel, "list", ""))?;
    let left: Vec<_> = folders.into_iter().filter(|name| name.starts_with(PREFIX)).collect();
    if left.is_empty() {
        return Ok(0);
    }
    for folder in &left {
        let path = format!("{folder}/tasks");
        let threads = kernel.read(&path).map_err(cannot(kernel, "read", &path))?;
        let threads: Vec<_> = threads.split_whitespace().collect();
        if !threads.is_empty() {
            let path = kernel.full_path(folder).display().to_string();
            return Err(GroupError::InUse { path, threads: threads.join(", ") });
        }
    }
    let info = info(kernel)?;
    if let Some(cache) = info.cache {
        let divided = default_group(kernel)?;
        let less = divided.of(Resource::Cache).filter(|(_, ways)| *ways != cache.all);
        let whole: Vec<_> =
            less.map(|(domain, _)| Resource::Cache.line(domain, cache.all)).collect();
        write_all(kernel, SCHEMATA, &whole)?;
    }
    for folder in &left {
        kernel.remove(folder).map_err(cannot(kernel, "remove", folder))?;
    }
    Ok(left.len())
}

fn find_plan(kernel: &impl Kernel, asked: &[Asked]) -> Result<Plan, GroupError> {
    let mut others = Vec::new();
    for name in kernel.folders().map_err(cannot(kernel, "list", ""))? {
        if resctrl::is_group(&name) {
            let path = format!("{name}/{SCHEMATA}");
            let text = kernel.read(&path).map_err(cannot(kernel, "read", &path))?;
            others.push((name, Schemata::new(&text)));
        }
    }
    Ok(resctrl::plan(asked, info(kernel)?, &default_group(kernel)?, &others)?)
}

fn info(kernel: &impl Kernel) -> Result<Info, GroupError> {
    Ok(resctrl::info(&kernel.vendor(), |path| kernel.read(path))?)
}

fn default_group(kernel: &impl Kernel) -> Result<Schemata, GroupError> {
    let text = kernel.read(SCHEMATA).map_err(cannot(kernel, "read", SCHEMATA))?;
    Ok(Schemata::new(&text))
}

fn write_all(kernel: &impl Kernel, path: &str, lines: &[String]) -> Result<(), GroupError> {
    lines
        .iter()
        .try_for_each(|line| kernel.write(path, line))
        .map_err(cannot(kernel, "write to", path))
}

fn cannot(
    kernel: &impl Kernel,
    what: &'static str,
    path: &str,
) -> impl FnOnce(io::Error) -> GroupError {
    let path = kernel.full_path(path).display().to_string();
    move |source| GroupError::Step { what, path, source }
}

#[cfg(test)]
#[path = "setup_tests.rs"]
mod tests;
