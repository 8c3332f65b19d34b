//! The host as its kernel describes it.
//!
//! Everything that a check reads comes through here, below a root folder: for a test that is a
//! recorded tree of another machine. Nothing here writes.

use std::ffi::OsString;
use std::fmt::Write;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use takt_host::cpu_list;
use takt_scheduler::table::Cpu;

use crate::steering::Steering;

/// Longest file that is read, in bytes. `/proc/interrupts` has a number for each interrupt and CPU: with
/// 256 CPUs and 1,500 interrupts these are 4 MiB.
const FILE_MAX: u64 = 64 << 20;

/// Capability numbers of `include/uapi/linux/capability.h`.
#[derive(Clone, Copy, Debug)]
pub enum Capability {
    /// CAP_IPC_LOCK: memory may be locked without a limit.
    LockMemory = 14,
    /// CAP_SYS_ADMIN: cgroups may be changed.
    Administer = 21,
    /// CAP_SYS_NICE: real-time classes may be asked for.
    Schedule = 23,
}

/// A host, or the record of one.
#[derive(Debug)]
pub struct Host {
    root: PathBuf,
    log: String,
    steering: Option<Steering>,
}

impl Host {
    /// The host that this process runs on.
    #[must_use]
    pub fn here() -> Self {
        Self { root: "/".into(), log: kernel_log(), steering: Steering::here() }
    }

    /// The host whose files lie below `root`, and whose kernel has logged `log`.
    #[cfg(test)]
    pub fn recorded(root: &Path, log: String) -> Self {
        Self { root: root.into(), log, steering: None }
    }

    /// The same with a clock that is steered so.
    #[cfg(test)]
    pub fn steered(self, steering: Option<Steering>) -> Self {
        Self { steering, ..self }
    }

    /// How its clock is steered; `None` if the kernel does not tell.
    #[must_use]
    pub fn steering(&self) -> Option<Steering> {
        self.steering
    }

    /// The folder that stands for `/`.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// A file's text, without the end of its last line. `path` has no `/` at its start.
    ///
    /// # Errors
    /// What the kernel says. A file beyond [`FILE_MAX`] is refused: a part of it could pass for all of it.
    pub fn read(&self, path: &str) -> io::Result<String> {
        let mut bytes = Vec::new();
        File::open(self.root.join(path))?.take(FILE_MAX + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > FILE_MAX {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        Ok(String::from_utf8_lossy(&bytes).trim_end().to_owned())
    }

    /// A file's text, if it is there and may be read.
    #[must_use]
    pub fn text(&self, path: &str) -> Option<String> {
        self.read(path).ok()
    }

    /// A file's number.
    #[must_use]
    pub fn number(&self, path: &str) -> Option<u64> {
        self.text(path)?.trim().parse().ok()
    }

    /// A file's list of CPUs.
    #[must_use]
    pub fn cpus(&self, path: &str) -> Option<Vec<Cpu>> {
        cpu_list::parse(&self.text(path)?)
    }

    /// Names in a folder, in order; numbers by their value.
    #[must_use]
    pub fn names(&self, path: &str) -> Vec<String> {
        let entries = fs::read_dir(self.root.join(path)).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .map(|e| e.file_name())
            .map(OsString::into_string)
            .filter_map(Result::ok)
            .collect();
        names.sort_by_key(|name| (name.len(), name.clone()));
        names
    }

    /// The word in brackets, of a file that offers several.
    #[must_use]
    pub fn chosen(&self, path: &str) -> Option<String> {
        let text = self.text(path)?;
        let (_, rest) = text.split_once('[')?;
        Some(rest.split_once(']')?.0.to_owned())
    }

    /// All CPUs that are online.
    #[must_use]
    pub fn online(&self) -> Vec<Cpu> {
        self.cpus("sys/devices/system/cpu/online").unwrap_or_else(|| vec![Cpu(0)])
    }

    /// CPUs that the kernel has left out of its scheduling domains at its start (`isolcpus`), be they there or not.
    /// Those of `isolcpus=managed_irq,...` are not among them.
    #[must_use]
    pub fn isolated(&self) -> Vec<Cpu> {
        self.cpus("sys/devices/system/cpu/isolated").unwrap_or_default()
    }

    /// CPUs of the kernel's parameter `nohz_full`.
    #[must_use]
    pub fn nohz_full(&self) -> Vec<Cpu> {
        self.cpus("sys/devices/system/cpu/nohz_full").unwrap_or_default()
    }

    /// The value of a parameter on the kernel's command line; the last one counts.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<String> {
        self.parameters(name).pop()
    }

    /// All values of a parameter on the kernel's command line, where each of them counts.
    #[must_use]
    pub fn parameters(&self, name: &str) -> Vec<String> {
        let line = self.text("proc/cmdline").unwrap_or_default();
        let own = line.split(" -- ").next().unwrap_or_default();
        let words = own.split_whitespace().filter_map(|word| word.split_once('='));
        words.filter(|(key, _)| *key == name).map(|(_, value)| value.to_owned()).collect()
    }

    /// A field of `/proc/cpuinfo`, of the first processor.
    #[must_use]
    pub fn processor(&self, field: &str) -> Option<String> {
        let text = self.text("proc/cpuinfo")?;
        let mut fields = text.lines().filter_map(|line| line.split_once(':'));
        fields.find(|(name, _)| name.trim() == field).map(|(_, value)| value.trim().to_owned())
    }

    /// Whether the processor has a feature, by the kernel's name for it.
    #[must_use]
    pub fn has_feature(&self, name: &str) -> bool {
        self.processor("flags").is_some_and(|all| all.split_whitespace().any(|f| f == name))
    }

    /// Whether this process has a capability.
    #[must_use]
    pub fn may(&self, capability: Capability) -> bool {
        let status = self.text("proc/self/status").unwrap_or_default();
        let set = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
        let bits = set.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok());
        bits.is_some_and(|bits| bits >> (capability as u32) & 1 == 1)
    }

    /// The release of its kernel, as `uname -r` tells it.
    #[must_use]
    pub fn kernel(&self) -> String {
        let version = self.text("proc/version").unwrap_or_default();
        version.split_whitespace().nth(2).unwrap_or("?").to_owned()
    }

    /// What follows `start` in the line of the kernel's log that has it; the last such line.
    #[must_use]
    pub fn logged(&self, start: &str) -> Option<&str> {
        self.log.lines().rev().find_map(|line| line.split_once(start)).map(|(_, rest)| rest.trim())
    }
}

/// CPUs as the kernel writes them, such as `0-3,6`.
#[must_use]
pub fn written(cpus: &[Cpu]) -> String {
    let mut sorted: Vec<usize> = cpus.iter().map(|cpu| cpu.0).collect();
    sorted.sort_unstable();
    sorted.dedup();
    let mut out = String::new();
    let mut rest = &sorted[..];
    while let [first, ..] = *rest {
        let length = rest.iter().zip(first..).take_while(|(a, b)| **a == *b).count();
        let comma = if out.is_empty() { "" } else { "," };
        // Writing to a String cannot fail.
        let _ = match length {
            1 => write!(out, "{comma}{first}"),
            _ => write!(out, "{comma}{first}-{}", first + length - 1),
        };
        rest = &rest[length..];
    }
    out
}

/// What the kernel has logged and still keeps; empty if this process may not read it.
fn kernel_log() -> String {
    const READ_ALL: libc::c_int = 3;
    let mut buffer = vec![0u8; 1 << 20];
    // SAFETY: the kernel writes at most the given number of bytes into the live buffer.
    let read =
        unsafe { libc::klogctl(READ_ALL, buffer.as_mut_ptr().cast(), buffer.len() as libc::c_int) };
    buffer.truncate(usize::try_from(read).unwrap_or(0));
    String::from_utf8_lossy(&buffer).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorded::Recorded;

    #[test]
    fn a_file_that_is_too_long_is_not_read_in_part() {
        let tree = Recorded::named("workstation").unpack();
        let file = File::options().write(true).open(tree.host.root().join("proc/interrupts"));
        file.unwrap().set_len(FILE_MAX + 1).unwrap();
        let error = tree.host.read("proc/interrupts").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        assert_eq!(tree.host.text("proc/interrupts"), None);
    }

    #[test]
    fn cpus_are_written_as_the_kernel_does() {
        let cases: [(&[usize], &str); 4] =
            [(&[], ""), (&[3], "3"), (&[0, 1, 2, 5], "0-2,5"), (&[7, 1, 6, 1], "1,6-7")];
        for (cpus, text) in cases {
            let cpus: Vec<Cpu> = cpus.iter().copied().map(Cpu).collect();
            assert_eq!(written(&cpus), text);
            assert_eq!(cpu_list::parse(text).unwrap().len(), {
                let mut unique = cpus.clone();
                unique.sort_unstable();
                unique.dedup();
                unique.len()
            });
        }
    }
}
