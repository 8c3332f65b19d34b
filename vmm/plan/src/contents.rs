//! Whether the images of a partition are what they should be, and fit its memory, and where in it the
//! programs of a PLC lie.
//!
//! A wrong path that leads to some file is found here, where the file shows which line it is, and not
//! when the machine is started.

use std::fs::File;
use std::io::{self, Read};

use takt_abi::memory::IMAGE_BASE;

use super::diagnostic::Diagnostic;
use super::images::{self, Image};
use super::partition::Checked;
use super::placement;
use super::{Kind, Partition};
use crate::elf::{self, ElfError};
use crate::kernel::Kernel;

/// Checks the images of a partition, and places its programs.
pub fn check(checked: &mut Checked) -> Result<(), Diagnostic> {
    let Checked { partition, images, .. } = checked;
    match (&partition.kind, &images[..]) {
        (Kind::Plc { .. }, [image]) => {
            let end = check_plc(partition, image)?;
            placement::place(checked, end)
        }
        // The kernel that is built into `takt` ends below the first place for programs.
        (Kind::Plc { .. }, []) => placement::place(checked, IMAGE_BASE),
        (Kind::Linux { .. }, [kernel, initrd @ ..]) => {
            check_linux(partition, kernel, initrd.first())
        }
        _ => Ok(()),
    }
}

/// The end of a PLC's image in its memory.
fn check_plc(partition: &Partition, image: &Image) -> Result<u64, Diagnostic> {
    let bytes = images::open(&image.path).and_then(|file| Ok(read_elf(file)?));
    let bytes = bytes.map_err(|error| images::unreadable(image, &error))?;
    let memory = partition.memory_bytes();
    elf::check(&bytes, IMAGE_BASE, memory).map(|extent| extent.end).map_err(|error| {
        let found = format!("{} cannot be a PLC: {error}", image.path.display());
        let allowed = match error {
            ElfError::DoesNotFit { .. } => format!(
                "an image that lies between {IMAGE_BASE:#x} and the end of the memory, {memory:#x}"
            ),
            _ => "a static 64-bit x86 executable (ELF), such as plc-guest builds".to_owned(),
        };
        Diagnostic::new(image.span.clone(), found, allowed)
    })
}

fn check_linux(
    partition: &Partition,
    image: &Image,
    initrd: Option<&Image>,
) -> Result<(), Diagnostic> {
    let mut file = images::open(&image.path).map_err(|error| images::unreadable(image, &error))?;
    let kernel = Kernel::examine(&mut file, partition.memory_bytes()).map_err(|error| {
        let found = format!("{} cannot be a kernel: {error}", image.path.display());
        let allowed = "a 64-bit Linux kernel that fits the partition's memory: a bzImage, which \
                       distributions call vmlinuz, or an ELF vmlinux";
        Diagnostic::new(image.span.clone(), found, allowed)
    })?;
    let Some(initrd) = initrd else { return Ok(()) };
    let length = images::open(&initrd.path)
        .and_then(|file| Ok(file.metadata()?.len()))
        .map_err(|error| images::unreadable(initrd, &error))?;
    kernel.place_initrd(length).map(|_| ()).map_err(|error| {
        let allowed = format!(
            "at most {} bytes with this kernel and this `memory`",
            error.limit.saturating_sub(error.kernel_end)
        );
        Diagnostic::new(initrd.span.clone(), error.to_string(), allowed)
    })
}

/// All of an ELF file; of another file, which may have any length, only what shows that.
fn read_elf(mut file: File) -> io::Result<Vec<u8>> {
    const HEADER: u64 = 64;
    let mut bytes = Vec::new();
    (&file).take(HEADER).read_to_end(&mut bytes)?;
    if elf::is_elf(&bytes) {
        file.read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}
