//! The steps that set CPUs apart, and the same steps back.
//!
//! Whatever has been done is written down in [`Setup`] at once, so that undoing starts from the
//! truth wherever setting up stopped. Undoing goes on after a step that fails: a host that has
//! most of its CPUs back is better than one that has none.

use std::io;
use std::path::PathBuf;

use takt_host::cpu_list;
use takt_scheduler::table::Cpu;

use super::CpusetError;
use super::kernel::{Entry, Kernel};
use super::watch::VALID;

/// How often to look whether the last thread is gone, of all cgroups together: one that was joined still counts for a moment.
/// One that waits for a hung disk counts for as long as the disk likes, which the end of the run does not wait for.
const PATIENCE: usize = 100;

/// CPUs that are set apart.
pub struct Setup<K: Kernel> {
    kernel: K,
    /// Where the process was, if it was moved.
    home: Option<String>,
    /// True if the root cgroup's children have cpusets because of this.
    enabled: bool,
    own: Vec<Cpu>,
    left: Option<Cpu>,
}

impl<K: Kernel> Setup<K> {
    /// Sets `cpus` apart: all of them, or nothing is changed.
    ///
    /// # Errors
    /// See [`CpusetError`].
    pub fn make(kernel: K, cpus: &[Cpu]) -> Result<Self, CpusetError> {
        let mut this = Self { kernel, home: None, enabled: false, own: Vec::new(), left: None };
        match this.build(cpus) {
            Ok(()) => Ok(this),
            Err(error) => match this.undo() {
                Ok(_) => Err(error),
                Err(undo) => {
                    Err(CpusetError::AndNotUndone { error: error.into(), undo: undo.into() })
                }
            },
        }
    }

    /// The CPUs that have a domain of their own.
    pub fn own(&self) -> &[Cpu] {
        &self.own
    }

    /// The CPU that is alone in the root domain, since all others have been set apart.
    pub fn left(&self) -> Option<Cpu> {
        self.left
    }

    /// The CPUs that have a domain of their own, and the file that tells of each.
    pub fn partitions(&self) -> impl Iterator<Item = (Cpu, PathBuf)> {
        self.own.iter().map(|&cpu| (cpu, self.kernel.full_path(&partition(cpu))))
    }

    /// How a thread gets to `cpu`, if it cannot simply pin itself.
    pub fn entry(&self, cpu: Cpu) -> Option<Entry> {
        let threads = format!("{}/cgroup.threads", folder(cpu));
        self.own.contains(&cpu).then(|| Entry::by(self.kernel.full_path(&threads)))
    }

    fn build(&mut self, cpus: &[Cpu]) -> Result<(), CpusetError> {
        for &cpu in cpus {
            self.remove_left_over(cpu)?;
        }
        let (root, effective) = self.root_cpus()?;
        if let Some(&cpu) = cpus.iter().find(|cpu| !root.contains(cpu)) {
            return Err(CpusetError::NotInRoot { cpu, effective });
        }
        if root.iter().all(|cpu| cpus.contains(cpu)) {
            self.left = root.iter().min().copied();
        }
        self.enable()?;
        self.move_to_root()?;
        let left = self.left;
        for &cpu in cpus.iter().filter(|&&cpu| Some(cpu) != left) {
            self.set_apart(cpu)?;
        }
        for &cpu in cpus {
            let folder = self.own.contains(&cpu).then(|| folder(cpu));
            let refusal = self.kernel.refusal(cpu, folder.as_deref());
            if let Some(source) = refusal.map_err(CpusetError::Thread)? {
                return Err(CpusetError::StillRefused { cpu, source });
            }
        }
        Ok(())
    }

    /// A Takt that was killed could not undo anything.
    fn remove_left_over(&self, cpu: Cpu) -> Result<(), CpusetError> {
        let folder = folder(cpu);
        let threads = match self.kernel.read(&format!("{folder}/cgroup.threads")) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            other => other.map_err(self.cannot("read", &folder))?,
        };
        if !threads.trim().is_empty() {
            let name = |id: &str| format!("thread {id} ({})", self.kernel.name_of(id));
            let users: Vec<String> = threads.split_whitespace().map(name).collect();
            return Err(CpusetError::InUse {
                path: self.kernel.full_path(&folder).display().to_string(),
                users: users.join(", "),
            });
        }
        self.dissolve(&folder, &mut { PATIENCE })
    }

    /// CPUs of the root cgroup that no partition has, and the kernel's words for them.
    fn root_cpus(&self) -> Result<(Vec<Cpu>, String), CpusetError> {
        const FILE: &str = "cpuset.cpus.effective";
        let text = self.kernel.read(FILE).map_err(self.cannot("read", FILE))?;
        let no_list = || io::Error::other(format!("{text:?} is no list of CPUs"));
        let cpus = cpu_list::parse(&text).ok_or_else(no_list).map_err(self.cannot("read", FILE))?;
        Ok((cpus, text.trim_end().to_owned()))
    }

    fn enable(&mut self) -> Result<(), CpusetError> {
        const FILE: &str = "cgroup.subtree_control";
        let enabled = self.kernel.read(FILE).map_err(self.cannot("read", FILE))?;
        if !enabled.split_whitespace().any(|name| name == "cpuset") {
            self.write(FILE, "+cpuset")?;
            self.enabled = true;
        }
        Ok(())
    }

    fn move_to_root(&mut self) -> Result<(), CpusetError> {
        let home = self.kernel.home().map_err(self.cannot("find this process's place in", ""))?;
        if !home.is_empty() {
            self.write("cgroup.procs", "0")?;
            self.home = Some(home);
        }
        Ok(())
    }

    fn set_apart(&mut self, cpu: Cpu) -> Result<(), CpusetError> {
        let folder = folder(cpu);
        self.kernel.make(&folder).map_err(self.cannot("make", &folder))?;
        self.own.push(cpu);
        self.write(&format!("{folder}/cgroup.type"), "threaded")?;
        self.write(&format!("{folder}/cpuset.cpus"), &cpu.0.to_string())?;
        let partition = partition(cpu);
        self.write(&partition, VALID)?;
        let state = self.kernel.read(&partition).map_err(self.cannot("read", &partition))?;
        if state.trim() != VALID {
            return Err(CpusetError::Invalid {
                cpu,
                path: self.kernel.full_path(&partition).display().to_string(),
                state: state.trim().to_owned(),
            });
        }
        Ok(())
    }

    /// Undoes everything, and returns the CPUs that have come back. Does nothing the second time.
    ///
    /// # Errors
    /// The first step that failed; all others have been done.
    pub fn undo(&mut self) -> Result<Vec<Cpu>, CpusetError> {
        let own = std::mem::take(&mut self.own);
        let (mut steps, mut patience) = (Vec::new(), PATIENCE);
        for &cpu in own.iter().rev() {
            steps.push(self.dissolve(&folder(cpu), &mut patience));
        }
        if std::mem::take(&mut self.enabled) {
            steps.push(self.write("cgroup.subtree_control", "-cpuset"));
        }
        if let Some(home) = self.home.take() {
            let path = format!("{home}/cgroup.procs");
            steps.push(match self.kernel.write(&path, "0") {
                // systemd removes a scope when its last process has left it: there is no place to go back to.
                Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
                other => other.map_err(self.cannot("write to", &path)),
            });
        }
        steps.into_iter().collect::<Result<(), _>>()?;
        if !own.is_empty() {
            let (root, effective) = self.root_cpus()?;
            if let Some(&cpu) = own.iter().find(|cpu| !root.contains(cpu)) {
                return Err(CpusetError::NotBack { cpu, effective });
            }
        }
        Ok(own)
    }

    /// The folder of the root cgroup.
    pub fn root(&self) -> PathBuf {
        self.kernel.full_path("")
    }

    fn dissolve(&self, path: &str, patience: &mut usize) -> Result<(), CpusetError> {
        // The CPU comes back now, and not some time after the removal. If this fails, as where the
        // folder has just been made, the removal does it all the same.
        let _ = self.write(&format!("{path}/cpuset.cpus.partition"), "member");
        let mut removed = self.kernel.remove(path);
        while is_busy(&removed) && *patience > 0 {
            *patience -= 1;
            self.kernel.pause();
            removed = self.kernel.remove(path);
        }
        if is_busy(&removed) {
            self.leave_threads_to_root(path);
            removed = self.kernel.remove(path);
        }
        removed.map_err(self.cannot("remove", path))
    }

    fn leave_threads_to_root(&self, path: &str) {
        let threads = self.kernel.read(&format!("{path}/cgroup.threads")).unwrap_or_default();
        for thread in threads.split_whitespace() {
            // Of one that cannot be moved the removal tells, and one that is gone need not be.
            let _ = self.kernel.write("cgroup.threads", thread);
        }
    }

    fn write(&self, path: &str, text: &str) -> Result<(), CpusetError> {
        self.kernel.write(path, text).map_err(self.cannot("write to", path))
    }

    fn cannot(&self, what: &'static str, path: &str) -> impl FnOnce(io::Error) -> CpusetError {
        let path = self.kernel.full_path(path).display().to_string();
        move |source| CpusetError::Step { what, path, source }
    }
}

fn is_busy(removed: &io::Result<()>) -> bool {
    removed.as_ref().is_err_and(|error| error.raw_os_error() == Some(libc::EBUSY))
}

/// The cgroup of a CPU.
fn folder(Cpu(cpu): Cpu) -> String {
    format!("takt-cpu{cpu}")
}

/// What makes a scheduling domain of it, and tells whether it is one.
fn partition(cpu: Cpu) -> String {
    format!("{}/cpuset.cpus.partition", folder(cpu))
}

#[cfg(test)]
#[path = "setup_tests.rs"]
mod tests;
