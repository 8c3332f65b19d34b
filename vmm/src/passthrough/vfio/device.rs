//! A function that VFIO has handed over: its registers, its interrupt, its mastering of the bus.
//!
//! VFIO has reset it when it was opened, if it can be reset, and lets it neither master the bus nor
//! open an interrupt without being asked. The guest has no access to its configuration, so all that
//! is asked for there is asked for here.

use std::ffi::CString;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;

use vmm_sys_util::eventfd::EventFd;

use super::super::command;
use super::sys::{self, IrqAction};
use crate::event::eventfd;

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
        let found = command::read(&self.file, self.config)?;
        let wanted = found | command::PORTS | command::MEMORY;
        // VFIO reads the third bit as whether it may open the line at all.
        let wanted = match self.interrupts {
            true => wanted & !command::NO_INTERRUPT,
            false => wanted | command::NO_INTERRUPT,
        };
        let wanted = if on { wanted | command::MASTER } else { wanted & !command::MASTER };
        command::write(&self.file, self.config, wanted)?;
        let masters = command::read(&self.file, self.config)? & command::MASTER != 0;
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

    /// VFIO opens a line with its first eventfd. That one has no reader, and with the next one the
    /// line stays as it is: so nothing comes before the guest asks for it.
    fn close_line(&self) -> io::Result<()> {
        self.connect(&eventfd()?)?;
        sys::interrupt(&self.file, IrqAction::Mask)
    }
}

#[cfg(test)]
impl Device {
    /// A file in the place of a device, with the configuration space at `config`.
    pub fn of_file(file: File, config: u64, interrupts: bool) -> Self {
        Self { file, config, resets: false, interrupts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::FromRawFd;

    const CONFIG: u64 = 7 << 40;

    /// A device whose command register is `command`, and what it has then.
    fn device(command: u16, interrupts: bool) -> (Device, impl Fn() -> u16) {
        // SAFETY: the name is a literal; the descriptor is new.
        let file =
            unsafe { File::from_raw_fd(libc::memfd_create(c"c".as_ptr(), libc::MFD_CLOEXEC)) };
        command::write(&file, CONFIG, command).unwrap();
        let seen = file.try_clone().unwrap();
        let now = move || command::read(&seen, CONFIG).unwrap();
        (Device::of_file(file, CONFIG, interrupts), now)
    }

    #[test]
    fn a_function_masters_the_bus_when_it_is_let_and_decodes_always() {
        let (device, command) = device(0x0100, true);
        device.let_master(true).unwrap();
        assert_eq!(command(), 0x0107);
        device.let_master(false).unwrap();
        assert_eq!(command(), 0x0103);
    }

    #[test]
    fn a_line_that_is_not_asked_for_stays_closed() {
        let (unwanted, command) = device(0, false);
        unwanted.let_master(true).unwrap();
        assert_eq!(command(), 0x0407);
        let (wanted, command) = device(0x0400, true);
        wanted.let_master(false).unwrap();
        assert_eq!(command(), 0x0003);
    }

    #[test]
    fn a_bit_that_does_not_follow_is_an_error() {
        let zero = || File::options().read(true).write(true).open("/dev/zero").unwrap();
        let device = Device::of_file(zero(), 0, false);
        device.let_master(false).unwrap();
        assert!(device.let_master(true).unwrap_err().to_string().contains("bus-master"));
    }

    #[test]
    fn one_that_cannot_be_reset_is_not() {
        // A file has no such call, so it would be an error.
        let (mut device, _) = device(0, false);
        device.reset().unwrap();
        device.resets = true;
        assert!(device.reset().is_err());
    }
}
