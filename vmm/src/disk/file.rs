//! A disk's bytes in a file of the host.
//!
//! They go through the host's page cache unless the partition file says otherwise; either way what was written is on the
//! host's disk after a flush. The file is locked, so
//! that no second Takt writes what this one has cached in its guest, nor reads what changes under it.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use takt_devices::disk::{BUFFER_ALIGNMENT, Medium, SECTOR, Shape};
use thiserror::Error;
use vmm_sys_util::fallocate::{FallocateMode, fallocate};

use crate::config::{self, Unreadable};

/// A disk's file that cannot be used.
#[derive(Debug, Error)]
pub enum DiskFileError {
    /// It cannot be opened as it has to be.
    #[error("cannot open the disk {}: {reason}{}", path.display(), if *.read_only { "" } else { "; to read a file that may not be written, say read_only = true" })]
    Open {
        /// Of the file.
        path: PathBuf,
        /// Whether it was only to be read.
        read_only: bool,
        /// What is in the way.
        reason: Unreadable,
    },
    /// Its bytes cannot go past the host's page cache.
    #[error("the disk {} cannot be used with direct = true: {source}; its file system has to allow it (tmpfs does not), in pieces of {SECTOR} bytes; leave direct out to use the host's page cache", path.display())]
    Direct {
        /// Of the file.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// Another program has it.
    #[error("the disk {} is in use by another program, most likely another takt; end that, or let each have a copy of its own", path.display())]
    InUse {
        /// Of the file.
        path: PathBuf,
    },
    /// Its file system knows no locks.
    #[error("cannot lock the disk {}: {source}; put it on a file system of this machine", path.display())]
    Lock {
        /// Of the file.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// It has changed since the partition file was checked.
    #[error("the disk {} has {bytes} bytes, which is no whole number of sectors of {SECTOR}; truncate -s makes it longer", path.display())]
    Size {
        /// Of the file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
    },
}

/// An open and locked file.
pub(super) struct DiskFile {
    file: File,
    /// Why a flush has failed, as the kernel's number.
    unflushed: Option<i32>,
}

impl DiskFile {
    /// Opens a disk's file: for itself alone if the guest may write, else together with others that
    /// only read.
    pub(super) fn open(disk: &config::Disk) -> Result<(Self, Shape), DiskFileError> {
        let config::Disk { path, read_only, direct } = disk;
        let (path, read_only) = (path.clone(), *read_only);
        let mut file = match open(&path, read_only) {
            Ok(file) => file,
            Err(reason) => return Err(DiskFileError::Open { path, read_only, reason }),
        };
        if *direct {
            file = match open_direct(&path, read_only) {
                Ok(file) => file,
                Err(source) => return Err(DiskFileError::Direct { path, source }),
            };
        }
        let locked = if read_only { file.try_lock_shared() } else { file.try_lock() };
        match locked {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(DiskFileError::InUse { path }),
            Err(TryLockError::Error(source)) => return Err(DiskFileError::Lock { path, source }),
        }
        match file.metadata() {
            Ok(metadata) if metadata.len() > 0 && metadata.len().is_multiple_of(SECTOR) => Ok((
                Self { file, unflushed: None },
                Shape { sectors: metadata.len() / SECTOR, read_only },
            )),
            Ok(metadata) => Err(DiskFileError::Size { path, bytes: metadata.len() }),
            Err(error) => Err(DiskFileError::Open { path, read_only, reason: error.into() }),
        }
    }
}

/// Looks first what it is: opening a pipe would wait for ever.
fn open(path: &Path, read_only: bool) -> Result<File, Unreadable> {
    let file = config::open_file(path)?;
    if read_only {
        return Ok(file);
    }
    Ok(OpenOptions::new().read(true).write(true).open(path)?)
}

/// Opens it so that transfers go past the page cache, and tries the smallest that a guest may ask for: a file system that
/// has larger blocks refuses it.
fn open_direct(path: &Path, read_only: bool) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let file = options.read(true).write(!read_only).custom_flags(libc::O_DIRECT).open(path)?;
    let mut memory = [0; SECTOR as usize + BUFFER_ALIGNMENT];
    let start = memory.as_ptr().align_offset(BUFFER_ALIGNMENT);
    let sector = memory.get_mut(start..).and_then(|aligned| aligned.get_mut(..SECTOR as usize));
    // The second, since the first lies at the start of a block of any size. A file of one sector has none.
    file.read_at(sector.unwrap_or_default(), SECTOR)?;
    Ok(file)
}

impl Medium for DiskFile {
    fn read(&mut self, at: u64, into: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(into, at)
    }

    fn write(&mut self, at: u64, from: &[u8]) -> io::Result<()> {
        self.file.write_all_at(from, at)
    }

    fn discard(&mut self, at: u64, bytes: u64) -> io::Result<()> {
        let keep_size = true;
        fallocate(&self.file, FallocateMode::PunchHole, keep_size, at, bytes)
            .map_err(|error| io::Error::from_raw_os_error(error.errno()))
    }

    /// The kernel tells once that it could not write something, and forgets it then. So after a flush that has failed none
    /// succeeds, also for a guest that was started anew meanwhile: what it wrote before may be lost.
    fn flush(&mut self) -> io::Result<()> {
        if let Some(reason) = self.unflushed {
            return Err(io::Error::from_raw_os_error(reason));
        }
        self.file.sync_data().inspect_err(|error| {
            self.unflushed = Some(error.raw_os_error().unwrap_or(libc::EIO));
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::MetadataExt;

    use vmm_sys_util::tempdir::TempDir;

    use super::*;

    /// A folder with a disk of four sectors, of which number n is full of n.
    fn disk(read_only: bool) -> (TempDir, config::Disk) {
        let folder = TempDir::new().unwrap();
        let path = folder.as_path().join("disk");
        let bytes: Vec<u8> = (0..4 * SECTOR).map(|n| (n / SECTOR) as u8).collect();
        fs::write(&path, bytes).unwrap();
        (folder, config::Disk { path, read_only, direct: false })
    }

    fn refusal(disk: &config::Disk) -> String {
        DiskFile::open(disk).err().unwrap().to_string()
    }

    #[test]
    fn bytes_go_to_their_place_and_come_back() {
        let (_folder, disk) = disk(false);
        let (mut file, shape) = DiskFile::open(&disk).unwrap();
        assert_eq!(shape, Shape { sectors: 4, read_only: false });
        file.write(512, &[7; 512]).unwrap();
        file.flush().unwrap();
        assert_eq!(fs::read(&disk.path).unwrap(), [0, 7, 2, 3].map(|n| [n; 512]).concat());
        let mut read = [0; 1024];
        file.read(1024, &mut read).unwrap();
        assert_eq!((read[511], read[512]), (2, 3));
    }

    #[test]
    fn after_a_flush_that_has_failed_none_succeeds() {
        let (_folder, disk) = disk(false);
        let (good, _) = DiskFile::open(&disk).unwrap();
        // What is no file on a disk cannot be flushed.
        let mut file =
            DiskFile { file: File::options().write(true).open("/dev/null").unwrap(), ..good };
        let first = file.flush().unwrap_err();
        file.file = File::options().write(true).open(&disk.path).unwrap();
        assert_eq!(file.flush().unwrap_err().raw_os_error(), first.raw_os_error());
        file.write(0, &[7; 512]).unwrap();
    }

    #[test]
    fn what_is_discarded_is_no_longer_in_use_and_the_length_stays() {
        let (_folder, disk) = disk(false);
        fs::write(&disk.path, vec![7; 1 << 20]).unwrap();
        let (mut file, _) = DiskFile::open(&disk).unwrap();
        file.flush().unwrap();
        let used = || fs::metadata(&disk.path).unwrap().blocks();
        let before = used();
        file.discard(1 << 18, 1 << 19).unwrap();
        assert_eq!(before - used(), (1 << 19) / 512);
        let bytes = fs::read(&disk.path).unwrap();
        let kept = bytes.iter().filter(|byte| **byte == 7).count();
        assert_eq!((bytes.len(), kept), (1 << 20, 1 << 19));
    }

    #[test]
    fn a_file_that_became_shorter_is_an_error_and_no_end() {
        let (_folder, disk) = disk(false);
        let (mut file, _) = DiskFile::open(&disk).unwrap();
        let mut pieces = [0; 1024];
        assert!(file.read(1024, &mut pieces).is_ok());
        File::options().write(true).open(&disk.path).unwrap().set_len(1536).unwrap();
        assert!(file.read(1024, &mut pieces).is_err());
        assert!(file.read(1 << 40, &mut pieces).is_err());
        assert!(file.read(u64::MAX, &mut pieces).is_err());
    }

    #[test]
    fn who_may_write_is_alone_and_who_reads_is_among_readers() {
        let (_folder, reader) = disk(true);
        let writer = config::Disk { read_only: false, ..reader.clone() };
        let first = DiskFile::open(&reader).unwrap();
        let second = DiskFile::open(&reader).unwrap();
        assert!(refusal(&writer).contains("in use by another program"));
        drop((first, second));
        let _writer = DiskFile::open(&writer).unwrap();
        assert!(refusal(&writer).contains("in use by another program"));
        assert!(refusal(&reader).contains("in use by another program"));
    }

    #[test]
    fn what_is_no_disk_is_refused() {
        let (folder, mut disk) = disk(false);
        fs::write(&disk.path, [0; 513]).unwrap();
        assert!(refusal(&disk).contains("has 513 bytes"));
        fs::write(&disk.path, []).unwrap();
        assert!(refusal(&disk).contains("has 0 bytes"));
        disk.path = folder.as_path().to_owned();
        assert!(refusal(&disk).contains("not a regular file"));
        disk.path = folder.as_path().join("none");
        assert!(refusal(&disk).contains("No such file"));
    }
}
