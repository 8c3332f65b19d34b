//! The memory of a PCI function as something to read from.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use thiserror::Error;
use vm_memory::mmap::{MmapRegion, MmapRegionError};
use vm_memory::{FileOffset, VolatileMemory};

/// Why the memory cannot be read.
#[derive(Debug, Error)]
pub enum MapError {
    #[error("cannot open {}: {source}", path.display())]
    Open { path: PathBuf, source: io::Error },
    #[error("cannot map {}: {source}", path.display())]
    Map { path: PathBuf, source: MmapRegionError },
}

/// The memory, from its beginning to its end. The kernel lets it be mapped only.
pub struct ReadMemory {
    region: MmapRegion,
    at: usize,
}

impl ReadMemory {
    /// Maps the file that is the memory.
    ///
    /// # Errors
    /// See [`MapError`].
    pub fn open(path: &Path) -> Result<Self, MapError> {
        let failed = |source| MapError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        let failed = |source| MapError::Map { path: path.to_owned(), source };
        let bytes =
            usize::try_from(bytes).map_err(|_| failed(MmapRegionError::InvalidOffsetLength))?;
        let file = Some(FileOffset::new(file, 0));
        let region = MmapRegion::build(file, bytes, libc::PROT_READ, libc::MAP_SHARED);
        Ok(Self { region: region.map_err(failed)?, at: 0 })
    }
}

impl Read for ReadMemory {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = buffer.len().min(self.region.len() - self.at);
        let slice = self.region.get_slice(self.at, count).map_err(io::Error::other)?;
        self.at += count;
        Ok(slice.copy_to(buffer))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use vmm_sys_util::tempfile::TempFile;

    #[test]
    fn all_of_the_memory_is_read_and_nothing_behind_it() {
        let file = TempFile::new().unwrap();
        let bytes: Vec<u8> = (0..10_001_u32).map(|at| (at % 251) as u8).collect();
        file.as_file().write_all(&bytes).unwrap();
        let mut memory = ReadMemory::open(file.as_path()).unwrap();
        let mut read = Vec::new();
        // An archive is read in pieces of any length, from any place on.
        for length in [1, 3, 8, 512, 7, 4_095] {
            let mut piece = vec![0; length];
            assert_eq!(memory.read(&mut piece).unwrap(), length);
            read.extend(piece);
        }
        memory.read_to_end(&mut read).unwrap();
        assert!(read == bytes);
        assert_eq!(memory.read(&mut [0; 16]).unwrap(), 0);
    }

    #[test]
    fn an_empty_file_and_one_that_is_missing_are_errors() {
        let file = TempFile::new().unwrap();
        assert!(matches!(ReadMemory::open(file.as_path()), Err(MapError::Map { .. })));
        let missing = Path::new("/no/such/file");
        assert!(matches!(ReadMemory::open(missing), Err(MapError::Open { .. })));
    }
}
