//! A PCI bus with one function on it, through which a Linux guest reaches its ports.
//!
//! The Linux guest is unmodified, so there is no driver of ours in it. PCI is the way to hand it
//! memory without one: Linux finds the function by itself, programs map its pages through
//! `/sys/bus/pci/devices/0000:00:01.0/resource1` and `resource2`, and Linux's own driver
//! `uio_pci_generic` makes of its interrupt something to wait for. Other ways were considered: a
//! range of its own in the memory map appears to programs only in kernels with device DAX, and a
//! virtio device needs a driver that knows its kind.
//!
//! | address | what |
//! | --- | --- |
//! | `00:00.0` | [host bridge](host_bridge), without which Linux does not believe in the bus |
//! | `00:01.0` | the [function](function::Function) |
//!
//! Configuration space is reached by the two ports of [`config_ports`]. There is no memory-mapped
//! one: nothing here lies beyond the first 64 bytes. Of the bus only what these two need is there:
//! no bridges, no I/O or 64-bit addresses, no capabilities, no message-signalled interrupts, which
//! `uio_pci_generic` does not use.
//!
//! Sources: PCI Local Bus Specification 3.0 (sections 3.2.2.3.2 and 6.1 to 6.2), and for what Linux
//! really does `arch/x86/pci/direct.c`, `drivers/pci/probe.c` and `drivers/uio/uio_pci_generic.c`.

pub mod bar;
pub mod config_ports;
pub mod function;
pub mod host_bridge;

/// Vendor and device of the host bridge, and of the [function](function::Function) below.
///
/// Identifiers cost membership of the PCI-SIG. Red Hat gives a part of its own to virtual devices,
/// and of that 1af4:10f0 to 1af4:10ff to anybody for experiments, without registration (QEMU,
/// `docs/specs/pci-ids.rst`). It asks for a registered one before a product is shipped. The range
/// is beside virtio's, whose Linux driver knows its devices by vendor; it refuses those with
/// numbers above 0x107f.
pub const HOST_BRIDGE_ID: Identity = Identity { vendor: 0x1af4, device: 0x10f1 };
/// Vendor and device of the function; programs find it by them.
pub const FUNCTION_ID: Identity = Identity { vendor: 0x1af4, device: 0x10f0 };

/// What a function is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Vendor ID.
    pub vendor: u16,
    /// Device ID.
    pub device: u16,
}

impl Identity {
    /// As it lies in registers 0x00 and 0x2c.
    const fn word(self) -> u32 {
        (self.device as u32) << 16 | self.vendor as u32
    }
}

/// A register of configuration space: 32 bits, counted from 0 (byte offset 0) to 63.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Register(u8);

impl Register {
    const IDENTITY: Self = Self::at(0x00);
    const COMMAND_STATUS: Self = Self::at(0x04);
    const CLASS: Self = Self::at(0x08);
    const BAR_0: Self = Self::at(0x10);
    const SUBSYSTEM: Self = Self::at(0x2c);
    const INTERRUPT: Self = Self::at(0x3c);

    /// By the byte offset, as the specification counts.
    const fn at(offset: u8) -> Self {
        Self(offset / 4)
    }
}

/// The configuration space of one function. As on the bus itself, an access is always to one
/// register; narrower ones select bytes of it.
pub trait ConfigSpace: Send {
    /// All bytes of a register.
    fn read(&mut self, register: Register) -> u32;
    /// Replaces those bits of a register that are set in `bytes`.
    fn write(&mut self, register: Register, value: u32, bytes: u32);
}
