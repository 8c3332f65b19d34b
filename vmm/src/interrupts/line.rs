//! The line of one device, as the host hands it over: by UIO or VFIO, one interrupt at a time.
//!
//! UIO tells of an interrupt by a file that can be read, and leaves it to the user how the line is
//! opened again (`Documentation/driver-api/uio-howto.rst` of the kernel). The kernel's driver for
//! PCI functions closes it by a bit of the command register, which is opened through configuration
//! space; drivers for other devices take a 1 or a 0. VFIO closes a line with each interrupt, and has an
//! eventfd for either way, one of which is KVM's at the same time.

use std::fs::File;
use std::io::{self, Read, Write};
use std::sync::Arc;

use vmm_sys_util::eventfd::EventFd;

use crate::passthrough::command;
use crate::passthrough::vfio::device::Device;

/// Where a device interrupts.
#[derive(Debug)]
pub enum Line {
    /// A PCI function's, with the driver `uio_pci_generic`.
    Pci {
        /// Tells of interrupts. Not blocking.
        uio: File,
        /// Its configuration space.
        config: File,
        /// The command register with the line open.
        armed: u16,
    },
    /// That of a device whose own driver opens and closes it.
    Uio(File),
    /// A PCI function's, with the driver `vfio-pci`.
    Vfio {
        /// The function.
        device: Arc<Device>,
        /// A write opens the line.
        opener: EventFd,
    },
}

impl Line {
    /// Lets the device interrupt once.
    ///
    /// # Errors
    /// What the host says.
    pub fn arm(&self) -> io::Result<()> {
        match self {
            Line::Pci { config, armed, .. } => command::write(config, 0, *armed),
            Line::Uio(uio) => switch(uio, true),
            Line::Vfio { opener, .. } => opener.write(1),
        }
    }

    /// Lets the device write to `signal` by itself, if it can. Otherwise see
    /// [`teller`](Self::teller).
    ///
    /// # Errors
    /// What the host says.
    pub fn connect(&self, signal: &EventFd) -> io::Result<()> {
        match self {
            Line::Vfio { device, .. } => device.connect(signal),
            Line::Pci { .. } | Line::Uio(_) => Ok(()),
        }
    }

    /// What can be read when the device has interrupted; `None` if the line needs no reader.
    #[must_use]
    pub fn teller(&self) -> Option<&File> {
        match self {
            Line::Pci { uio, .. } | Line::Uio(uio) => Some(uio),
            Line::Vfio { .. } => None,
        }
    }

    /// Whether it has interrupted, since this was last asked. The line is closed then.
    ///
    /// # Errors
    /// What the host says, other than that nothing has happened.
    pub fn take(&self) -> io::Result<bool> {
        let Some(mut teller) = self.teller() else { return Ok(false) };
        // How many interrupts there have been, ever.
        let mut count = [0; 4];
        match teller.read(&mut count) {
            Ok(4) => {}
            Ok(_) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
            Err(error) => return Err(error),
        }
        if let Line::Uio(uio) = self {
            // The driver may have left it open.
            switch(uio, false)?;
        }
        Ok(true)
    }
}

/// Opens or closes the line of a device whose driver can.
///
/// # Errors
/// What the host says: `ENOSYS` or `EIO` if the driver cannot.
pub fn switch(mut uio: &File, on: bool) -> io::Result<()> {
    uio.write_all(&u32::from(on).to_ne_bytes())
}
