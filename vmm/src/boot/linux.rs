//! Booting an unmodified Linux by its 64-bit boot protocol.
//!
//! The kernel's `Documentation/arch/x86/boot.rst` gives the contract: a page of boot parameters,
//! a memory map in it, the command line and the initial RAM disk somewhere in memory, and an entry
//! in long mode with the parameters' address in RSI. A `bzImage` and an ELF `vmlinux` differ only
//! in where the entry point is.
//!
//! [`takt_plan::linux_map`] has the places.

use std::fs::File;
use std::io::{self, Seek};
use std::path::{Path, PathBuf};

use linux_loader::cmdline::Cmdline;
use linux_loader::configurator::linux::LinuxBootConfigurator;
use linux_loader::configurator::{BootConfigurator, BootParams};
use linux_loader::loader::bootparam::{boot_e820_entry, boot_params, setup_header};
use linux_loader::loader::{BzImage, Elf, KernelLoader, load_cmdline};
use takt_devices::power::AcpiPower;
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress};

use super::acpi::{self, AcpiConfig};
use super::long_mode::Entry;
use crate::memory::GuestMemory;
use takt_plan::kernel::{self, Form, InitrdError, Kernel, KernelError};
use takt_plan::linux_map::{
    ACPI_TABLES, BOOT_PARAMETERS, COMMAND_LINE, HIGH_RAM_START, HOLE_START, LOW_RAM_END,
    RESTART_VECTOR,
};

/// Longest command line, without its NUL: `COMMAND_LINE_SIZE` of x86 Linux is 2048.
const COMMAND_LINE_MAX: usize = 2047;

/// `mov dx, reset register; mov al, reset value; out dx, al; 1: hlt; jmp 1b`
const RESTART: [u8; 9] = {
    let [low, high] = (acpi::POWER_PORT + AcpiPower::RESET).to_le_bytes();
    [0xba, low, high, 0xb0, AcpiPower::RESET_VALUE, 0xee, 0xf4, 0xeb, 0xfd]
};

const E820_RAM: u32 = 1;
const E820_RESERVED: u32 = 2;

/// A file of the user's that stays open: a guest may have to be loaded again when no path can be
/// opened any more.
#[derive(Debug)]
pub struct Image {
    path: PathBuf,
    file: File,
}

impl Image {
    /// Opens it.
    ///
    /// # Errors
    /// [`LinuxImageError::Read`].
    pub fn open(path: &Path) -> Result<Self, LinuxImageError> {
        let read = |source| LinuxImageError::Read { path: path.to_owned(), source };
        Ok(Self { path: path.to_owned(), file: File::open(path).map_err(read)? })
    }
}

/// A Linux that cannot be started.
#[derive(Debug, Error)]
pub enum LinuxImageError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the host said.
        source: io::Error,
    },
    /// It is no kernel, or none for this partition.
    #[error("{} cannot be a partition's kernel: {source}", path.display())]
    Kernel {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: KernelError,
    },
    /// linux-loader refused the kernel.
    #[error("the kernel {} cannot be loaded: {source}", path.display())]
    Load {
        /// The file.
        path: PathBuf,
        /// What linux-loader said.
        source: linux_loader::loader::Error,
    },
    /// Kernel and RAM disk do not fit into memory together.
    #[error(transparent)]
    Initrd(#[from] InitrdError),
    /// The command line is too long or has characters that cannot be there.
    #[error("the command line cannot be used: {0}")]
    CommandLine(String),
    /// The boot parameters do not fit; the memory is absurdly small.
    #[error("the boot parameters cannot be written: {0}")]
    Parameters(String),
}

/// The loaded kernel, before its parameters are written.
struct Loaded {
    kernel: Kernel,
    entry: u64,
    header: setup_header,
}

/// Loads kernel, RAM disk and tables into memory, which tell of the machine's `fittings`.
///
/// # Errors
/// See [`LinuxImageError`].
pub fn load(
    memory: &GuestMemory,
    kernel: &mut Image,
    initrd: Option<&mut Image>,
    cmdline: &str,
    fittings: AcpiConfig,
) -> Result<Entry, LinuxImageError> {
    let mut parameters = boot_params::default();
    let Loaded { kernel, entry, header } = load_kernel(memory, kernel)?;
    parameters.hdr = header;
    // "Undefined boot loader", as the protocol calls one without a number of its own.
    parameters.hdr.type_of_loader = 0xff;
    parameters.hdr.cmd_line_ptr = COMMAND_LINE as u32;
    parameters.hdr.cmdline_size = cmdline.len() as u32;
    if let Some(image) = initrd {
        let (address, bytes) = load_initrd(memory, image, kernel)?;
        parameters.hdr.ramdisk_image = address;
        parameters.hdr.ramdisk_size = bytes;
    }
    write_cmdline(memory, cmdline)?;
    memory
        .regions()
        .write_slice(&RESTART, GuestAddress(RESTART_VECTOR))
        .map_err(|e| LinuxImageError::Parameters(e.to_string()))?;
    parameters.acpi_rsdp_addr = acpi::write(memory.regions(), fittings)
        .map_err(|e| LinuxImageError::Parameters(e.to_string()))?;
    write_memory_map(&mut parameters, memory);
    LinuxBootConfigurator::write_bootparams(
        &BootParams::new(&parameters, GuestAddress(BOOT_PARAMETERS)),
        memory.regions(),
    )
    .map_err(|e| LinuxImageError::Parameters(e.to_string()))?;
    Ok(Entry { rip: entry, rdi: 0, rsi: BOOT_PARAMETERS })
}

fn load_kernel(memory: &GuestMemory, image: &mut Image) -> Result<Loaded, LinuxImageError> {
    /// The 64-bit entry point of a bzImage, from where it was loaded.
    const ENTRY_64: u64 = 0x200;

    let Image { path, file } = image;
    let load = |source| LinuxImageError::Load { path: path.to_owned(), source };
    let kernel = Kernel::examine(file, low_ram_end(memory))
        .map_err(|source| LinuxImageError::Kernel { path: path.to_owned(), source })?;
    let start = GuestAddress(kernel::LOWEST);
    match kernel.form {
        Form::BzImage => {
            let loaded = BzImage::load(memory.regions(), None, file, Some(start)).map_err(load)?;
            let header = loaded.setup_header.unwrap_or_default();
            Ok(Loaded { kernel, entry: loaded.kernel_load.0 + ENTRY_64, header })
        }
        Form::Elf => {
            let loaded = Elf::load(memory.regions(), None, file, None).map_err(load)?;
            // What a boot loader has to say of itself where the kernel brings no header.
            let header = setup_header {
                boot_flag: 0xaa55,
                header: u32::from_le_bytes(*b"HdrS"),
                version: 0x020c,
                initrd_addr_max: u32::MAX,
                ..Default::default()
            };
            Ok(Loaded { kernel, entry: loaded.kernel_load.0, header })
        }
    }
}

/// Puts the RAM disk at the end of low memory. Returns its address and size.
fn load_initrd(
    memory: &GuestMemory,
    image: &mut Image,
    kernel: Kernel,
) -> Result<(u32, u32), LinuxImageError> {
    let Image { path, file } = image;
    let read = |source| LinuxImageError::Read { path: path.to_owned(), source };
    file.rewind().map_err(read)?;
    let bytes = file.metadata().map_err(read)?.len();
    let (start, size) = kernel.place_initrd(bytes)?;
    memory
        .regions()
        .read_exact_volatile_from(GuestAddress(start.into()), file, size as usize)
        .map_err(|e| read(io::Error::other(e)))?;
    Ok((start, size))
}

fn write_cmdline(memory: &GuestMemory, text: &str) -> Result<(), LinuxImageError> {
    let error = |e: &dyn std::fmt::Display| LinuxImageError::CommandLine(e.to_string());
    let mut cmdline = Cmdline::new(COMMAND_LINE_MAX + 1).map_err(|e| error(&e))?;
    if !text.is_empty() {
        cmdline.insert_str(text).map_err(|e| error(&e))?;
    }
    load_cmdline(memory.regions(), GuestAddress(COMMAND_LINE), &cmdline).map_err(|e| error(&e))
}

/// End of the RAM below the device hole.
fn low_ram_end(memory: &GuestMemory) -> u64 {
    memory.ram().next().map_or(0, |(_, bytes)| bytes.min(HOLE_START))
}

fn write_memory_map(parameters: &mut boot_params, memory: &GuestMemory) {
    let low = [
        (0, LOW_RAM_END, E820_RAM),
        (ACPI_TABLES, HIGH_RAM_START - ACPI_TABLES, E820_RESERVED),
        (HIGH_RAM_START, low_ram_end(memory).saturating_sub(HIGH_RAM_START), E820_RAM),
    ];
    let high = memory.ram().skip(1).map(|(start, bytes)| (start, bytes, E820_RAM));
    let mut count = 0;
    for (slot, (addr, size, r#type)) in
        parameters.e820_table.iter_mut().zip(low.into_iter().chain(high))
    {
        *slot = boot_e820_entry { addr, size, r#type };
        count += 1;
    }
    parameters.e820_entries = count;
}
