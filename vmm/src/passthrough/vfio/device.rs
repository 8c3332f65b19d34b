//! A function that VFIO has handed over: its registers, its interrupt, its mastering of the bus.
//!
//! VFIO has reset it when it was opened, if it can be reset, and lets it neither master the bus nor
//! open an interrupt without being asked. The guest has no access to its configuration, so all that
//! is asked for there is asked for here.

use std::ffi::CString;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::FileExt;

use vmm_sys_util::eventfd::{EFD_CLOEXEC, EFD_NONBLOCK, EventFd};

use super::super::pci::{
    COMMAND, COMMAND_MASTER, COMMAND_MEMORY, COMMAND_NO_INTERRUPT, COMMAND_PORTS,
};
use super::sys::{self, IrqAction};

/// A function. The partition's end is the end of its last use.
#[derive(Debug)]
pub struct Device {
    file: File,
    /// Where in the file its configuration space is.
    config: u64,
    resets: bool,
    /// Its line is in use.
    interrupts: bool,
}

impl Device {
    /// Opens the function `name` of a group that has an address space.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn open(group: &File, name: &str, interrupts: bool) -> io::Result<Self> {
        let name = CString::new(name).map_err(|_| io::ErrorKind::InvalidInput)?;
        let file = sys::device(group, &name)?;
        let (config, _) = sys::region(&file, sys::CONFIG_REGION)?;
        let resets = sys::can_reset(&file)?;
        let this = Self { file, config, resets, interrupts };
        this.let_master(false)?;
        if interrupts {
            this.close_line()?;
        }
        Ok(this)
    }

    /// Its file, and where the memory behind a register is in there; `None` if it cannot be mapped.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn memory(&self, bar: u8) -> io::Result<Option<(&File, u64)>> {
        let (offset, mappable) = sys::region(&self.file, bar.into())?;
        Ok(mappable.then_some((&self.file, offset)))
    }

    /// Whether it can be reset.
    #[must_use]
    pub fn resets(&self) -> bool {
        self.resets
    }

    /// Resets it, if it can be. That takes the kernel 0.1 s and more.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn reset(&self) -> io::Result<()> {
        if self.resets { sys::reset(&self.file) } else { Ok(()) }
    }

    /// Lets it master the bus, or not. When this returns `Ok` after a no, what it had under way has
    /// arrived: the answer to the read comes behind it (PCI Local Bus 3.0, 3.2.5).
    ///
    /// # Errors
    /// What the kernel says.
    pub fn let_master(&self, on: bool) -> io::Result<()> {
        let place = self.config + COMMAND;
        let mut bytes = [0; 2];
        self.file.read_exact_at(&mut bytes, place)?;
        let wanted = u16::from_le_bytes(bytes) | COMMAND_PORTS | COMMAND_MEMORY;
        // VFIO reads the third bit as whether it may open the line at all.
        let wanted = match self.interrupts {
            true => wanted & !COMMAND_NO_INTERRUPT,
            false => wanted | COMMAND_NO_INTERRUPT,
        };
        let wanted = if on { wanted | COMMAND_MASTER } else { wanted & !COMMAND_MASTER };
        self.file.write_all_at(&wanted.to_le_bytes(), place)?;
        self.file.read_exact_at(&mut bytes, place)?;
        let masters = u16::from_le_bytes(bytes) & COMMAND_MASTER != 0;
        if masters == on {
            Ok(())
        } else {
            Err(io::Error::other("the bus-master bit stays as it was"))
        }
    }

    /// An eventfd, each write to which opens the line once.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn opener(&self) -> io::Result<EventFd> {
        let opener = eventfd()?;
        sys::interrupt(&self.file, IrqAction::UnmaskBy(opener.as_raw_fd()))?;
        Ok(opener)
    }

    /// Tells of interrupts by `signal` from now on. Each closes the line.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn connect(&self, signal: &EventFd) -> io::Result<()> {
        sys::interrupt(&self.file, IrqAction::Trigger(signal.as_raw_fd()))
    }

    /// VFIO opens a line with its first eventfd. That one is nobody's, and with the next one the
    /// line stays as it is: so nothing comes before the guest asks for it.
    fn close_line(&self) -> io::Result<()> {
        self.connect(&eventfd()?)?;
        sys::interrupt(&self.file, IrqAction::Mask)
    }
}

fn eventfd() -> io::Result<EventFd> {
    EventFd::new(EFD_NONBLOCK | EFD_CLOEXEC)
}
