//! Noticing that a CPU has lost its scheduling domain.
//!
//! The kernel calls a partition invalid when its CPU goes offline, or when another process changes the cpusets around it. A
//! service manager that finds no use for the controller takes it from the root's children, and the partition goes with it. No
//! process is told of any of that, and Takt has to look. Threads keep the reservations that they have, so the run goes on.
//!
//! The supervisor thread looks, once a second, by a `pread` of files that were opened before the sandbox was entered.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

use takt_scheduler::table::Cpu;
use takt_scheduler::time::Nanos;

/// How often it is looked.
const INTERVAL: Nanos = Nanos::from_millis(1_000);
/// Most bytes of a state, with the kernel's reason.
const STATE_BYTES: usize = 128;
/// The state of a partition that is one.
pub(super) const VALID: &str = "root";

/// The scheduling domains of a run, as they were when they were last looked at.
#[derive(Debug, Default)]
pub struct DomainWatch {
    domains: Vec<Domain>,
    looked: Nanos,
}

#[derive(Debug)]
struct Domain {
    cpu: Cpu,
    state: File,
    lost: bool,
}

impl DomainWatch {
    /// Opens what is looked at later. A file that cannot be opened is not looked at.
    pub(super) fn open(files: impl Iterator<Item = (Cpu, PathBuf)>) -> Self {
        let domain = |(cpu, file)| Some(Domain { cpu, state: File::open(file).ok()?, lost: false });
        Self { domains: files.filter_map(domain).collect(), looked: Nanos::ZERO }
    }

    /// Looks, if it is time; `now` counts from the epoch. Says which CPUs have lost their domains, once each time that
    /// they do.
    pub fn look(&mut self, now: Nanos) -> Vec<String> {
        // A counter that has gone back leaves `looked` in the future.
        if now >= self.looked && now.less(self.looked) < INTERVAL {
            return Vec::new();
        }
        self.looked = now;
        self.domains.iter_mut().filter_map(Domain::look).collect()
    }
}

impl Domain {
    fn look(&mut self) -> Option<String> {
        let mut bytes = [0; STATE_BYTES];
        let state = match self.state.read_at(&mut bytes, 0) {
            Ok(read) => bytes.get(..read)?.trim_ascii_end().escape_ascii().to_string(),
            // The controller was taken away.
            Err(error) => error.to_string(),
        };
        let was_lost = std::mem::replace(&mut self.lost, state != VALID);
        let Cpu(cpu) = self.cpu;
        (self.lost && !was_lost).then(|| {
            format!(
                "CPU {cpu} has lost its scheduling domain ({state}): threads of the host may run on it until the next start of takt"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_domain_that_is_lost_is_told_once_each_time() {
        let path = std::env::temp_dir().join(format!("takt-domain-{}", std::process::id()));
        fs::write(&path, "root\n").unwrap();
        let missing = (Cpu(2), "/nowhere".into());
        let mut watch = DomainWatch::open([(Cpu(1), path.clone()), missing].into_iter());
        let mut seconds = 0;
        let mut after = |state: &str| {
            fs::write(&path, state).unwrap();
            seconds += 1;
            assert!(watch.look(Nanos::from_millis(1_000 * seconds - 1)).is_empty(), "too early");
            watch.look(Nanos::from_millis(1_000 * seconds))
        };
        let invalid = "root invalid (Cpu list in cpuset.cpus not exclusive)\n";
        assert!(after("root\n").is_empty());
        let news = after(invalid);
        let expected = "CPU 1 has lost its scheduling domain (root invalid (Cpu list in cpuset.cpus not exclusive)): ";
        assert!(news.len() == 1 && news[0].starts_with(expected), "{news:?}");
        assert!(after(invalid).is_empty());
        assert!(after("root\n").is_empty());
        assert_eq!(after("member\n").len(), 1);
        fs::remove_file(&path).unwrap();
    }
}
