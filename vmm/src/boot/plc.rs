//! Loading a PLC guest: a static ELF executable, linked to where it lies.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use linux_loader::loader::{Elf, KernelLoader};
use takt_abi::memory::{IMAGE_BASE, INFORMATION};
use thiserror::Error;

use super::elf::{self, ElfError};
use super::long_mode::Entry;
use crate::memory::GuestMemory;

/// The demonstration guest, for partitions that name no image.
const BUILT_IN: &[u8] = include_bytes!(env!("TAKT_PLC_GUEST"));

/// A PLC image that cannot be started.
#[derive(Debug, Error)]
pub enum PlcImageError {
    /// The file cannot be read.
    #[error("cannot read the PLC image {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// It is no program for this partition.
    #[error("the PLC image {name} cannot be used: {source}")]
    Unfit {
        /// The file, or "built-in".
        name: String,
        /// Why not.
        source: ElfError,
    },
    /// The loader refused it.
    #[error("the PLC image {name} cannot be loaded: {source}")]
    Load {
        /// The file, or "built-in".
        name: String,
        /// What linux-loader said.
        source: linux_loader::loader::Error,
    },
}

/// Loads `image`, or the built-in guest, into RAM of `memory_bytes` that is still zero: that is
/// what clears the image's `.bss`.
///
/// # Errors
/// See [`PlcImageError`].
pub fn load(
    memory: &GuestMemory,
    memory_bytes: u64,
    image: Option<&Path>,
) -> Result<Entry, PlcImageError> {
    let read;
    let (name, bytes) = match image {
        None => ("built-in".to_owned(), BUILT_IN),
        Some(path) => {
            read = std::fs::read(path)
                .map_err(|source| PlcImageError::Read { path: path.to_owned(), source })?;
            (path.display().to_string(), read.as_slice())
        }
    };
    if let Err(source) = elf::check(bytes, IMAGE_BASE, memory_bytes) {
        return Err(PlcImageError::Unfit { name, source });
    }
    match Elf::load(memory.regions(), None, &mut Cursor::new(bytes), None) {
        Ok(loaded) => Ok(Entry { rip: loaded.kernel_load.0, rdi: INFORMATION, rsi: 0 }),
        Err(source) => Err(PlcImageError::Load { name, source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vm_memory::{Bytes, GuestAddress};

    #[test]
    fn the_built_in_guest_fits_a_small_partition() {
        let memory = GuestMemory::for_plc(4 << 20).unwrap();
        let entry = load(&memory, 4 << 20, None).unwrap();
        assert!(entry.rip >= IMAGE_BASE);
        let first: u64 = memory.regions().read_obj(GuestAddress(entry.rip)).unwrap();
        assert_ne!(first, 0, "no code at the entry point");
    }

    #[test]
    fn an_image_that_is_not_one_is_refused_by_name() {
        let memory = GuestMemory::for_plc(4 << 20).unwrap();
        let error = load(&memory, 4 << 20, Some(Path::new(file!()))).unwrap_err();
        assert!(matches!(error, PlcImageError::Read { .. }), "{error}");
        let error = load(&memory, 4 << 20, Some(Path::new("/proc/self/cmdline"))).unwrap_err();
        assert!(error.to_string().contains("/proc/self/cmdline"), "{error}");
    }
}
