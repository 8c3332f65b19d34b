//! The way out for results: the debug console of an emulator, a port that takes bytes.
//!
//! A serial port would be the obvious way, but each of its bytes costs an interrupt and several
//! accesses in the guest: a trace of a few megabytes took minutes.

use std::arch::asm;
use std::io::{self, Write};
use std::marker::PhantomData;

/// Where `scripts/` puts QEMU's `isa-debugcon`, and where Bochs has its `port_e9_hack`; both answer reads
/// with [`PRESENT`].
const PORTS: [u16; 2] = [0x402, 0xe9];
/// What is read from the port if the device is there (QEMU's hw/char/debugcon.c, the iodev/unmapped.cc
/// of Bochs).
const PRESENT: u8 = 0xe9;

/// The port, found to be there.
pub(super) struct ResultPort {
    port: u16,
    /// The permission is this thread's, so the value must stay on it.
    _not_send: PhantomData<*mut u8>,
}

impl ResultPort {
    /// Looks for the device. `None` on a machine that has none, such as a real one.
    pub(super) fn find() -> Option<ResultPort> {
        PORTS.into_iter().find_map(Self::at)
    }

    fn at(port: u16) -> Option<ResultPort> {
        // SAFETY: asks for this thread's access to one port; changes no memory.
        if unsafe { libc::ioperm(port.into(), 1, 1) } != 0 {
            return None;
        }
        let answer: u8;
        // SAFETY: the access is allowed now. A machine without the device answers all ones; no PC
        // has another device there whose reading has an effect.
        unsafe {
            asm!("in al, dx", in("dx") port, out("al") answer, options(nomem, nostack, preserves_flags));
        }
        (answer == PRESENT).then_some(ResultPort { port, _not_send: PhantomData })
    }
}

impl Write for ResultPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // SAFETY: reads exactly the live slice; this thread may access the port, since a value of
        // this type exists and is never sent to another.
        unsafe {
            asm!(
                "rep outsb",
                in("dx") self.port,
                inout("rsi") bytes.as_ptr() => _,
                inout("rcx") bytes.len() => _,
                options(readonly, nostack, preserves_flags),
            );
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
