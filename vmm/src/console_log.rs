//! A file that keeps what a partition writes to its console.
//!
//! A thread of its own writes, so that a slow disk holds up nothing. What waits for the disk is bounded. What finds no room
//! is left out, counted, and told of in the file at its place and at the end of the run.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::host_ports::files::Recording;
use crate::outlet::Outlet;
use crate::sandbox::Mode;
use crate::screen::budget::Bucket;
use crate::vcpu::thread::ThreadError;

/// Room for what waits for the disk: some seconds of a guest that prints as much as it may.
const WAITING_BYTES: usize = 512 << 10;
/// What a partition may add to its file in a second: twice what it may show, so that none loses anything here that has to wait
/// for its reader. A guest that does not wait could fill the host's disk.
const BYTES_PER_SECOND: u64 = 128 << 10;
/// How long the end of a run waits for a disk that takes nothing.
const PATIENCE: Duration = Duration::from_millis(20);

/// Why a console cannot be kept.
#[derive(Debug, Error)]
pub enum ConsoleLogError {
    /// The file cannot be opened.
    #[error("cannot keep a console in {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// The host gives no thread.
    #[error(transparent)]
    Thread(#[from] ThreadError),
}

/// Such a file.
pub struct ConsoleLog {
    path: PathBuf,
    outlet: Outlet,
    budget: Bucket<BYTES_PER_SECOND>,
    grown: Instant,
    /// Bytes left out since the last that were taken, and in all.
    gap: u64,
    left_out: u64,
}

impl ConsoleLog {
    /// Opens the file, or makes it; what is there stays.
    ///
    /// # Errors
    /// See [`ConsoleLogError`].
    pub fn start(path: &Path, mode: Mode) -> Result<Self, ConsoleLogError> {
        let file = Recording::open(path);
        let file =
            file.map_err(|source| ConsoleLogError::File { path: path.to_owned(), source })?;
        Ok(Self::of(path, Outlet::start("log", mode, &[WAITING_BYTES], file)?))
    }

    fn of(path: &Path, outlet: Outlet) -> Self {
        let (budget, grown) = (Bucket::FULL, Instant::now());
        Self { path: path.to_owned(), outlet, budget, grown, gap: 0, left_out: 0 }
    }

    /// Keeps what the partition has written by now.
    pub fn take(&mut self, bytes: &[u8], now: Instant) {
        self.budget.grow(now.saturating_duration_since(self.grown));
        self.grown = now;
        let most = usize::try_from(self.budget.left()).unwrap_or(usize::MAX);
        let (kept, beyond) = bytes.split_at(most.min(bytes.len()));
        self.budget.spend(kept.len() as u64);
        if !kept.is_empty() {
            self.keep(kept);
        }
        self.leave_out(beyond);
    }

    fn keep(&mut self, bytes: &[u8]) {
        let told = match self.gap {
            0 => Vec::new(),
            gap => format!("\n[takt] {gap} bytes are left out here\n").into_bytes(),
        };
        match self.outlet.push(0, &[&told, bytes].concat()) {
            Ok(()) => self.gap = 0,
            Err(_) => self.leave_out(bytes),
        }
    }

    const fn leave_out(&mut self, bytes: &[u8]) {
        self.gap += bytes.len() as u64;
        self.left_out += bytes.len() as u64;
    }

    /// Why nothing is written any more, once.
    #[must_use]
    pub fn error(&self) -> Option<String> {
        let error = self.outlet.take_error()?;
        Some(format!("its console is not kept any more in {}: {error}", self.path.display()))
    }

    /// Waits for the disk at the end of a run, no longer than `most`; what is missing in the file, if anything is.
    #[must_use]
    pub fn finish(&self, most: Duration) -> Option<String> {
        self.outlet.settle(PATIENCE, most);
        let missing = self.left_out + self.outlet.unwritten();
        (missing > 0)
            .then(|| format!("{missing} bytes of its console are not in {}", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::thread;

    use vmm_sys_util::tempdir::TempDir;

    use super::*;
    use crate::outlet::Sink;

    /// Longer than any test may need; reached only if one fails.
    const LONG: Duration = Duration::from_secs(60);

    fn log(path: &Path, sink: impl Sink) -> ConsoleLog {
        let (outlet, work) = Outlet::new(&[WAITING_BYTES], sink);
        thread::spawn(work);
        ConsoleLog::of(path, outlet)
    }

    /// As [`ConsoleLog::finish`], however busy the machine is.
    fn end(log: &ConsoleLog) -> Option<String> {
        log.outlet.settle(LONG, LONG);
        log.finish(LONG)
    }

    #[test]
    fn what_is_written_is_appended_and_what_finds_no_room_is_told_at_its_place() {
        let folder = TempDir::new().unwrap();
        let path = folder.as_path().join("linux.log");
        fs::write(&path, "before\n").unwrap();
        let mut log = log(&path, Recording::open(&path).unwrap());
        let start = Instant::now();
        log.take(b"one", start);
        log.keep(&vec![b'x'; WAITING_BYTES]);
        log.take(b"two\n", start);
        let told = end(&log).unwrap();
        assert!(told.starts_with("524288 bytes of its console are not in "), "{told}");
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text, "before\none\n[takt] 524288 bytes are left out here\ntwo\n");
        assert_eq!(log.error(), None);
    }

    #[test]
    fn a_guest_that_floods_its_console_does_not_fill_the_disk() {
        let folder = TempDir::new().unwrap();
        let path = folder.as_path().join("plc.log");
        let mut log = log(&path, Recording::open(&path).unwrap());
        let start = log.grown;
        // 16 KiB in each tick of 20 ms, for 10 s.
        for tick in 0..500 {
            log.take(&[b'x'; 16 << 10], start + Duration::from_millis(20 * tick));
            log.outlet.settle(LONG, LONG);
        }
        let all = 500 * (16 << 10);
        let kept = all - log.left_out;
        assert!((10..=11).contains(&(kept / BYTES_PER_SECOND)), "{kept}");
        assert!(end(&log).is_some());
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text.matches('x').count() as u64, kept);
        assert!(text.contains(" bytes are left out here\n"));
    }

    /// A disk that has room for some bytes.
    struct Small(usize);

    impl Sink for Small {
        fn put(&mut self, piece: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
            self.0 = self.0.checked_sub(piece.len()).ok_or(io::ErrorKind::StorageFull)?;
            written(piece.len());
            Ok(())
        }

        fn goes_on(&self) -> bool {
            false
        }
    }

    #[test]
    fn a_disk_that_is_full_is_told_once_and_the_rest_is_missing() {
        let mut log = log(Path::new("linux.log"), Small(4));
        log.take(b"one\n", Instant::now());
        assert_eq!((end(&log), log.error()), (None, None));
        log.take(b"two\n", Instant::now());
        assert_eq!(end(&log).unwrap(), "4 bytes of its console are not in linux.log");
        let error = log.error().unwrap();
        assert!(error.starts_with("its console is not kept any more in linux.log: "), "{error}");
        log.take(b"three\n", Instant::now());
        assert_eq!(log.error(), None);
        assert_eq!(end(&log).unwrap(), "10 bytes of its console are not in linux.log");
    }

    #[test]
    fn what_is_no_file_to_append_to_is_refused() {
        let error = ConsoleLog::start(Path::new("/dev/null"), Mode::Enforce).err().unwrap();
        assert!(error.to_string().starts_with("cannot keep a console in /dev/null: "), "{error}");
    }
}
