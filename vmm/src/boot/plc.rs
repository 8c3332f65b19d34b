//! Loading a PLC guest: a static ELF executable, linked to where it lies.
//!
//! The image is read once and kept: a partition that is started again must not depend on a file
//! that may be gone by then.

use std::borrow::Cow;
use std::io::{self, Cursor};
use std::ops::Range;
use std::path::{Path, PathBuf};

use linux_loader::loader::{Elf, KernelLoader};
use takt_abi::memory::{IMAGE_BASE, INFORMATION, PAGE, STATUS};
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress, GuestMemoryError};

use super::StartMode;
use super::long_mode::Entry;
use crate::memory::GuestMemory;
use takt_plan::elf::{self, ElfError};

/// For partitions that name neither an image nor programs.
const DEMO: &[u8] = include_bytes!(env!("TAKT_PLC_DEMO"));
/// For partitions with programs that name no image.
const KERNEL: &[u8] = include_bytes!(env!("TAKT_PLC_KERNEL"));

/// Where an image comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source<'a> {
    /// The demonstration, which is built in.
    Demo,
    /// The kernel for program images, which is built in.
    Kernel,
    /// This file.
    File(&'a Path),
}

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
        /// The file, or which built-in one.
        name: String,
        /// Why not.
        source: ElfError,
    },
    /// The loader refused it.
    #[error("the PLC image {name} cannot be loaded: {source}")]
    Load {
        /// The file, or which built-in one.
        name: String,
        /// What linux-loader said.
        source: linux_loader::loader::Error,
    },
    /// The partition's memory could not be cleared for it.
    #[error("the memory for the PLC image {name} cannot be cleared: {source}")]
    Clear {
        /// The file, or which built-in one.
        name: String,
        /// What vm-memory said.
        source: GuestMemoryError,
    },
}

/// An image that fits its partition.
#[derive(Clone, Debug)]
pub struct PlcImage {
    name: String,
    bytes: Cow<'static, [u8]>,
    /// RAM of the partition.
    memory_bytes: u64,
    /// What a warm start leaves alone, in order.
    retained: Vec<Range<u64>>,
}

impl PlcImage {
    /// Reads and checks an image for a partition with RAM of `memory_bytes`.
    ///
    /// # Errors
    /// See [`PlcImageError`].
    pub fn read(source: Source<'_>, memory_bytes: u64) -> Result<PlcImage, PlcImageError> {
        let (name, bytes) = match source {
            Source::Demo => ("built-in demo".to_owned(), Cow::Borrowed(DEMO)),
            Source::Kernel => ("built-in kernel".to_owned(), Cow::Borrowed(KERNEL)),
            Source::File(path) => {
                let bytes = std::fs::read(path)
                    .map_err(|source| PlcImageError::Read { path: path.to_owned(), source })?;
                (path.display().to_string(), Cow::Owned(bytes))
            }
        };
        match elf::check(&bytes, IMAGE_BASE, memory_bytes) {
            Ok(extent) => {
                let mut retained = extent.retained;
                retained.sort_by_key(|range| range.start);
                Ok(PlcImage { name, bytes, memory_bytes, retained })
            }
            Err(source) => Err(PlcImageError::Unfit { name, source }),
        }
    }

    /// Loads it into memory that is zero: that is what clears the image's `.bss`.
    ///
    /// # Errors
    /// See [`PlcImageError`].
    pub fn load(&self, memory: &GuestMemory) -> Result<Entry, PlcImageError> {
        match Elf::load(memory.regions(), None, &mut Cursor::new(&self.bytes), None) {
            Ok(loaded) => Ok(Entry { rip: loaded.kernel_load.0, rdi: INFORMATION, rsi: 0 }),
            Err(source) => Err(PlcImageError::Load { name: self.name.clone(), source }),
        }
    }

    /// Clears the memory of a guest that has run, as far as `mode` says, and loads it again. The
    /// guest must not run meanwhile.
    ///
    /// # Errors
    /// See [`PlcImageError`].
    pub fn reload(&self, memory: &GuestMemory, mode: StartMode) -> Result<Entry, PlcImageError> {
        let kept: &[Range<u64>] = match mode {
            StartMode::Cold => &[],
            StartMode::Warm => &self.retained,
        };
        let mut from = 0;
        for gap in kept.iter().chain([&(self.memory_bytes..self.memory_bytes)]) {
            self.clear(memory, from..gap.start)?;
            from = from.max(gap.end);
        }
        self.clear(memory, STATUS..STATUS + PAGE)?;
        self.load(memory)
    }

    fn clear(&self, memory: &GuestMemory, range: Range<u64>) -> Result<(), PlcImageError> {
        static ZEROS: [u8; 1 << 16] = [0; 1 << 16];
        let mut at = range.start;
        while at < range.end {
            let length = (range.end - at).min(ZEROS.len() as u64);
            memory
                .regions()
                .write_slice(&ZEROS[..length as usize], GuestAddress(at))
                .map_err(|source| PlcImageError::Clear { name: self.name.clone(), source })?;
            at += length;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::Pages;

    const RAM: u64 = 4 << 20;

    #[test]
    fn the_built_in_guests_fit_a_small_partition() {
        for source in [Source::Demo, Source::Kernel] {
            let memory = GuestMemory::for_plc(RAM, Pages::Small, &[]).unwrap();
            let entry = PlcImage::read(source, RAM).unwrap().load(&memory).unwrap();
            assert!(entry.rip >= IMAGE_BASE);
            let first: u64 = memory.regions().read_obj(GuestAddress(entry.rip)).unwrap();
            assert_ne!(first, 0, "no code at the entry point of {source:?}");
        }
    }

    /// The first programs lie there: see `takt_plan`'s placement.
    #[test]
    fn the_kernel_ends_below_its_programs() {
        assert!(elf::check(KERNEL, IMAGE_BASE, 2 << 20).is_ok());
    }

    #[test]
    fn an_image_that_is_not_one_is_refused_by_name() {
        let error = PlcImage::read(Source::File(Path::new(file!())), RAM).unwrap_err();
        assert!(matches!(error, PlcImageError::Read { .. }), "{error}");
        let error = PlcImage::read(Source::File(Path::new("/proc/self/cmdline")), RAM).unwrap_err();
        assert!(error.to_string().contains("/proc/self/cmdline"), "{error}");
    }

    #[test]
    fn a_warm_start_keeps_what_is_retained_and_a_cold_one_nothing() {
        let memory = GuestMemory::for_plc(RAM, Pages::Small, &[]).unwrap();
        let mut image = PlcImage::read(Source::Demo, RAM).unwrap();
        image.retained.push(0x18_0000..0x18_1000);
        let entry = image.load(&memory).unwrap();
        let code: u64 = memory.regions().read_obj(GuestAddress(entry.rip)).unwrap();
        let places = [0, entry.rip, 0x17_fff8, 0x18_0000, 0x18_0ff8, 0x18_1000, RAM - 8, STATUS];
        let left = |mode| {
            for place in places {
                memory.regions().write_obj(7u64, GuestAddress(place)).unwrap();
            }
            assert_eq!(image.reload(&memory, mode).unwrap(), entry);
            places.map(|p| memory.regions().read_obj::<u64>(GuestAddress(p)).unwrap())
        };
        assert_eq!(left(StartMode::Warm), [0, code, 0, 7, 7, 0, 0, 0]);
        assert_eq!(left(StartMode::Cold), [0, code, 0, 0, 0, 0, 0, 0]);
    }
}
