//! The function itself: two pieces of memory, and an interrupt.
//!
//! | base address | `sysfs` | what |
//! | --- | --- | --- |
//! | 1 | `resource1` | what the guest may read: a page with its port table, then regions of channels |
//! | 2 | `resource2` | regions of channels that it may write |
//!
//! All of it is the VMM's business, which makes memory slots of regions and leaves the rest empty;
//! here is only where it lies. Both pieces can be prefetched. Memory is decoded even while the
//! command register says that it is not, since the slots are made once.
//!
//! # The interrupt
//!
//! It is on pin A and says that some source has rung a doorbell. On a PC it would be a level: the
//! function holds it until a program has told it to let go, shows it in the status register, and a
//! bit of the command register gates it (PCI 3.0, sections 6.2.2 and 6.2.3). To keep that state a
//! thread of the VMM would have to be woken for each ring. Here a ring is a pulse instead, from the
//! source's instruction to the guest's interrupt controller within the host's kernel, and the
//! machine's description says that the pin is triggered by edges. So
//!
//! - nothing is acknowledged. An edge that comes while the handler runs waits in the local APIC,
//!   and several that come before it are one.
//! - the status register shows an interrupt always. `uio_pci_generic` asks for it in its handler
//!   (`pci_check_and_mask_intx`) and wakes no reader without it; no other device has the pin, so whenever
//!   the handler runs, a peer has rung.
//! - the disable bit of the command register is stored and read back, which is all that Linux looks
//!   for (`pci_intx_mask_broken`), and holds nothing back. The driver sets it at the first interrupt
//!   and a program need not clear it.
//!
//! Either way an interrupt too many costs no more than a look: a reader that waits looks at its channel,
//! and waits again if there is nothing new.

use super::bar::{self, Bar, WindowFull};
use super::{ConfigSpace, FUNCTION_ID, Register};
use std::ops::RangeInclusive;

/// Class code "memory controller, other", revision 1. No Linux driver claims functions by this
/// class.
const CLASS_REVISION: u32 = 0x05_80_00 << 8 | 1;
/// Pin A, in the second byte of the interrupt register.
const PIN_A: u32 = 1 << 8;

/// Bits of the command register that can be written: memory space, and interrupt disable. The
/// function takes no part in the bus, so it has no other bit to switch.
const COMMAND_WRITABLE: u16 = 1 << 1 | 1 << 10;
/// Bit of the status register: an interrupt is pending.
const STATUS_INTERRUPT: u16 = 1 << 3;

/// Where the function's memory lies.
#[derive(Clone, Debug)]
pub struct Bars {
    /// What the guest may read.
    pub read_only: Bar,
    /// What it may read and write.
    pub read_write: Bar,
}

impl Bars {
    /// Places the memory in `window`, with so many bytes of each.
    ///
    /// # Errors
    /// [`WindowFull`].
    pub fn assign(
        window: &RangeInclusive<u32>,
        read_only: u64,
        read_write: u64,
    ) -> Result<Self, WindowFull> {
        let [read_only, read_write] = bar::assign(window, [read_only, read_write])?;
        Ok(Self { read_only, read_write })
    }
}

/// The function's configuration space.
pub struct Function {
    bars: Bars,
    command: u16,
    /// Linux notes here what it was told of the interrupt's number. The device does not use it.
    interrupt_number: u8,
}

impl Function {
    /// A function with its memory at `bars`.
    #[must_use]
    pub const fn new(bars: Bars) -> Self {
        Self { bars, command: 0, interrupt_number: 0 }
    }

    fn bar(&mut self, register: Register) -> Option<&mut Bar> {
        match register.0.checked_sub(Register::BAR_0.0)? {
            1 => Some(&mut self.bars.read_only),
            2 => Some(&mut self.bars.read_write),
            _ => None,
        }
    }
}

impl ConfigSpace for Function {
    fn read(&mut self, register: Register) -> u32 {
        match register {
            Register::IDENTITY | Register::SUBSYSTEM => FUNCTION_ID.word(),
            Register::COMMAND_STATUS => u32::from(STATUS_INTERRUPT) << 16 | u32::from(self.command),
            Register::CLASS => CLASS_REVISION,
            Register::INTERRUPT => PIN_A | u32::from(self.interrupt_number),
            other => self.bar(other).map_or(0, |bar| bar.read()),
        }
    }

    fn write(&mut self, register: Register, value: u32, bytes: u32) {
        match register {
            Register::COMMAND_STATUS => {
                // The lower half; nothing in the status register can be written.
                let (value, bytes) = (value as u16, bytes as u16 & COMMAND_WRITABLE);
                self.command = self.command & !bytes | value & bytes;
            }
            Register::INTERRUPT => {
                let (value, bytes) = (value as u8, bytes as u8);
                self.interrupt_number = self.interrupt_number & !bytes | value & bytes;
            }
            other => {
                if let Some(bar) = self.bar(other) {
                    bar.write(value, bytes);
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "function_tests.rs"]
pub(super) mod tests;
