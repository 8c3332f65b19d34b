//! What the file of a Linux kernel claims, before anything of it is loaded.
//!
//! linux-loader copies a kernel to where it belongs and says little of one that does not fit. A wrong
//! path should not wait for that: what a file is shows in its first bytes, and whether it fits its
//! partition is known with the partition file. The offsets are those of the kernel's
//! `Documentation/arch/x86/boot.rst`, "Details of Header Fields".

use std::fs::File;
use std::io::{self, Read, Seek};
use std::os::unix::fs::FileExt;

use thiserror::Error;

use super::elf::{self, ElfError};
use crate::linux_map::{HIGH_RAM_START, HOLE_START};

/// Where a kernel may begin: below lie the tables that it is started with.
pub const LOWEST: u64 = HIGH_RAM_START;
/// First boot protocol with a 64-bit entry point.
const PROTOCOL_MIN: u16 = 0x020c;
/// End of the header's fields that are read.
const HEADER_END: usize = 0x264;
const SECTOR: u64 = 512;
const PAGE: u64 = 4096;
/// Bit of `loadflags`: the kernel is loaded at 1 MiB or above.
const LOADED_HIGH: u8 = 1;
/// Bit of `xloadflags`: there is a 64-bit entry point.
const XLF_KERNEL_64: u16 = 1;

/// A file that no Linux can be started from.
#[derive(Debug, Error)]
pub enum KernelError {
    /// It cannot be read.
    #[error("it cannot be read: {0}")]
    Read(#[from] io::Error),
    /// Neither a bzImage nor a usable ELF file.
    #[error("it is neither a bzImage nor an ELF kernel: {0}")]
    Unknown(ElfError),
    /// A kernel for the first megabyte, or an old one without the 64-bit entry point.
    #[error(
        "it has no 64-bit entry point (boot protocol {0:#x}; 0x20c is needed, and a 64-bit kernel)"
    )]
    TooOld(u16),
    /// A part of it is missing.
    #[error("it is none, or cut short: it has {has} bytes and needs {needs} at the least")]
    Short {
        /// Length of the file.
        has: u64,
        /// What a header takes, or what the header says.
        needs: u64,
    },
    /// The partition is too small.
    #[error(
        "it needs memory up to {end:#x}, but the partition has {limit:#x} bytes: raise `memory`"
    )]
    DoesNotFit {
        /// End of what it needs.
        end: u64,
        /// End of the RAM that it may use.
        limit: u64,
    },
}

/// A RAM disk does not fit into memory beside its kernel.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error(
    "kernel and initrd do not fit: the kernel needs memory up to {kernel_end:#x}, the initrd of {bytes} bytes has to lie between there and {limit:#x}; raise `memory`"
)]
pub struct InitrdError {
    /// End of what the kernel needs.
    pub kernel_end: u64,
    /// Size of the RAM disk.
    pub bytes: u64,
    /// End of the memory that the RAM disk may use.
    pub limit: u64,
}

/// How a kernel is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// As a distribution ships it: it unpacks itself.
    BzImage,
    /// Not packed.
    Elf,
}

/// A kernel that fits its partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel {
    /// How it is packed.
    pub form: Form,
    /// End of the memory that it uses before it knows of its RAM disk.
    pub end: u64,
    /// End of the addresses at which its RAM disk may lie.
    pub initrd_limit: u64,
}

impl Kernel {
    /// Examines the file of a kernel for a partition with so much memory.
    ///
    /// # Errors
    /// See [`KernelError`].
    pub fn examine(file: &mut File, memory_bytes: u64) -> Result<Kernel, KernelError> {
        let limit = memory_bytes.min(HOLE_START);
        let length = file.metadata()?.len();
        let mut start = [0; HEADER_END];
        let kernel = match file.read_exact_at(&mut start, 0) {
            Ok(()) if start[0x202..0x206] == *b"HdrS" => bzimage(&start, length)?,
            Ok(()) if !elf::is_elf(&start) => {
                return Err(KernelError::Unknown(
                    elf::check(&start, LOWEST, limit).err().unwrap_or(ElfError::Kind),
                ));
            }
            Ok(()) => vmlinux(file, limit)?,
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                return Err(KernelError::Short { has: length, needs: HEADER_END as u64 });
            }
            Err(error) => return Err(error.into()),
        };
        if kernel.end > limit {
            return Err(KernelError::DoesNotFit { end: kernel.end, limit });
        }
        Ok(Kernel { initrd_limit: kernel.initrd_limit.min(limit), ..kernel })
    }

    /// Address and size of a RAM disk of so many bytes, which lies as high as may be, at a page.
    ///
    /// # Errors
    /// [`InitrdError`]: there is no room.
    pub fn place_initrd(&self, bytes: u64) -> Result<(u32, u32), InitrdError> {
        let Kernel { end, initrd_limit: limit, .. } = *self;
        let start = limit.checked_sub(bytes).map(|start| start & !(PAGE - 1));
        let fits = start.filter(|start| *start >= end).map(u32::try_from);
        match (fits, u32::try_from(bytes)) {
            (Some(Ok(start)), Ok(size)) => Ok((start, size)),
            _ => Err(InitrdError { kernel_end: end, bytes, limit }),
        }
    }
}

fn bzimage(start: &[u8; HEADER_END], length: u64) -> Result<Kernel, KernelError> {
    let byte = |at: usize| start[at];
    let word = |at: usize| u16::from_le_bytes([byte(at), byte(at + 1)]);
    let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 2)) << 16;
    let version = word(0x206);
    let high = byte(0x211) & LOADED_HIGH != 0 && long(0x214) >= LOWEST;
    if version < PROTOCOL_MIN || word(0x236) & XLF_KERNEL_64 == 0 || !high {
        return Err(KernelError::TooOld(version));
    }
    let setup = match byte(0x1f1) {
        // "For backwards compatibility, if the setup_sects field contains 0, the real value is 4."
        0 => 5 * SECTOR,
        sectors => (u64::from(sectors) + 1) * SECTOR,
    };
    let needs = setup + long(0x248) + long(0x24c);
    if length < needs {
        return Err(KernelError::Short { has: length, needs });
    }
    // Before it has read its parameters the kernel unpacks itself to its preferred address or
    // where it was loaded, whichever is higher, and works in `init_size` bytes from there.
    let preferred = long(0x258) | long(0x25c) << 32;
    let unpacked = preferred.max(LOWEST).saturating_add(long(0x260));
    let end = unpacked.max(LOWEST + (length - setup));
    Ok(Kernel { form: Form::BzImage, end, initrd_limit: long(0x22c) + 1 })
}

fn vmlinux(file: &mut File, limit: u64) -> Result<Kernel, KernelError> {
    let mut bytes = Vec::new();
    file.rewind()?;
    file.read_to_end(&mut bytes)?;
    let extent = elf::check(&bytes, LOWEST, limit).map_err(KernelError::Unknown)?;
    Ok(Kernel { form: Form::Elf, end: extent.end, initrd_limit: u64::from(u32::MAX) + 1 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    const MIB: u64 = 1 << 20;

    /// A bzImage of 3 sectors that unpacks to 16 MiB, in 8 MiB.
    fn image() -> Vec<u8> {
        let mut image = vec![0; 1536];
        let mut put = |at: usize, bytes: &[u8]| image[at..at + bytes.len()].copy_from_slice(bytes);
        put(0x1f1, &[1]);
        put(0x202, b"HdrS");
        put(0x206, &0x020fu16.to_le_bytes());
        put(0x211, &[1]);
        put(0x214, &0x10_0000u32.to_le_bytes());
        put(0x22c, &0x7fff_ffffu32.to_le_bytes());
        put(0x236, &1u16.to_le_bytes());
        put(0x24c, &512u32.to_le_bytes());
        put(0x258, &(16 * MIB).to_le_bytes());
        put(0x260, &(8 * MIB as u32).to_le_bytes());
        image
    }

    fn examine(bytes: &[u8], memory: u64) -> Result<Kernel, KernelError> {
        let name = format!("takt-kernel-{:?}", std::thread::current().id());
        let path = std::env::temp_dir().join(name);
        let mut options = File::options();
        let mut file =
            options.read(true).write(true).create(true).truncate(true).open(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        file.write_all(bytes).unwrap();
        Kernel::examine(&mut file, memory)
    }

    #[test]
    fn a_kernel_says_how_much_memory_it_takes() {
        let kernel = examine(&image(), 64 * MIB).unwrap();
        assert_eq!(kernel.form, Form::BzImage);
        assert_eq!((kernel.end, kernel.initrd_limit), (24 * MIB, 64 * MIB));
        let kernel = examine(&image(), 8 << 30).unwrap();
        assert_eq!(kernel.initrd_limit, 0x8000_0000);
        let elf = elf::tests::minimal(LOWEST, 16, 4096);
        let padded = [&elf[..], &[0; 1024]].concat();
        let kernel = examine(&padded, 64 * MIB).unwrap();
        assert_eq!((kernel.form, kernel.end), (Form::Elf, LOWEST + 4096));
    }

    #[test]
    fn a_kernel_that_the_memory_does_not_hold_is_refused() {
        assert!(examine(&image(), 24 * MIB).is_ok());
        let error = examine(&image(), 24 * MIB - 4096).unwrap_err();
        assert!(matches!(error, KernelError::DoesNotFit { end, .. } if end == 24 * MIB));
    }

    #[test]
    fn a_kernel_without_a_64_bit_entry_point_is_refused() {
        for (at, value) in [(0x206, 0x0b), (0x236, 0), (0x211, 0), (0x216, 0)] {
            let mut image = image();
            image[at] = value;
            let error = examine(&image, 64 * MIB).unwrap_err();
            assert!(matches!(error, KernelError::TooOld(_)), "{at:#x} {error}");
        }
    }

    #[test]
    fn what_is_cut_short_or_something_else_is_refused() {
        let image = image();
        for length in 0..image.len() {
            let error = examine(&image[..length], 64 * MIB).unwrap_err();
            assert!(matches!(error, KernelError::Short { .. }), "{length} {error}");
        }
        for other in
            [&[b'x'; 4096][..], b"\x7fELF and then nothing that makes sense".repeat(99).as_slice()]
        {
            assert!(matches!(examine(other, 64 * MIB), Err(KernelError::Unknown(_))));
        }
    }

    #[test]
    fn a_ram_disk_lies_between_the_kernel_and_the_end_of_memory() {
        let kernel = examine(&image(), 64 * MIB).unwrap();
        assert_eq!(kernel.place_initrd(5000), Ok(((64 * MIB - 8192) as u32, 5000)));
        assert!(kernel.place_initrd(40 * MIB).is_ok());
        let error = InitrdError { kernel_end: 24 * MIB, bytes: 40 * MIB + 1, limit: 64 * MIB };
        assert_eq!(kernel.place_initrd(40 * MIB + 1), Err(error));
        assert!(kernel.place_initrd(u64::MAX).is_err());
    }

    #[test]
    fn no_header_makes_the_examination_panic() {
        let image = image();
        for at in 0x1f1..HEADER_END {
            for value in [0, 0x7f, 0xff] {
                let mut image = image.clone();
                image[at] = value;
                let _ = examine(&image, 64 * MIB);
            }
        }
    }
}
