//! The host's I/O ports themselves.
//!
//! A thread may use those for which it has taken the privilege, and only that thread: whatever
//! else goes wrong in Takt, a port that no partition was given is out of reach of the threads that
//! run guests (`ioperm(2)`; the processor checks each access).

use std::arch::asm;
use std::io;

use super::ports::Ports;
use crate::vcpu::port_access::Width;

/// Lets the calling thread, and threads that it starts from now on, use these ports.
///
/// # Errors
/// Without `CAP_SYS_RAWIO`, on a locked-down host, or on one without `ioperm`.
pub fn grant(first: u16, last: u16) -> io::Result<()> {
    let count = libc::c_ulong::from(last) + 1 - libc::c_ulong::from(first);
    // SAFETY: changes which ports this thread may use, and no memory.
    let result = unsafe { libc::ioperm(first.into(), count, 1) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// The ports of the host, for a thread that has been [granted](grant) what it uses. An access to
/// another one ends the process.
#[derive(Clone, Copy, Debug)]
pub struct RealPorts;

impl Ports for RealPorts {
    fn read(&mut self, port: u16, width: Width) -> u32 {
        let value: u32;
        // SAFETY: an access to a port changes no memory of this process by itself. What the device
        // does on it, the partition file has allowed.
        unsafe {
            match width {
                Width::One => {
                    let byte: u8;
                    asm!("in al, dx", in("dx") port, out("al") byte, options(nostack));
                    value = byte.into();
                }
                Width::Two => {
                    let word: u16;
                    asm!("in ax, dx", in("dx") port, out("ax") word, options(nostack));
                    value = word.into();
                }
                Width::Four => {
                    asm!("in eax, dx", in("dx") port, out("eax") value, options(nostack));
                }
            }
        }
        value
    }

    fn write(&mut self, port: u16, width: Width, value: u32) {
        // SAFETY: as for `read`.
        unsafe {
            match width {
                Width::One => {
                    asm!("out dx, al", in("dx") port, in("al") value as u8, options(nostack));
                }
                Width::Two => {
                    asm!("out dx, ax", in("dx") port, in("ax") value as u16, options(nostack));
                }
                Width::Four => {
                    asm!("out dx, eax", in("dx") port, in("eax") value, options(nostack));
                }
            }
        }
    }
}
