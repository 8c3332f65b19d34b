//! The serial port that is the Linux guest's console.
//!
//! The registers are vm-superio's. What is added here: the lock between the vCPU thread, which
//! makes the guest's accesses, and the supervisor thread, which brings what was typed; and a queue for
//! typed bytes that the 16-byte-deep view of the guest has no room for yet.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use vm_superio::serial::NoEvents;
use vm_superio::{Serial, Trigger};
use vmm_sys_util::eventfd::EventFd;

use crate::output::ConsoleOutput;
use crate::ports::PortDevice;

/// Number of I/O ports of a 16550.
pub const PORTS: u16 = 8;
/// Offset of the register through which the guest prints.
const DATA: u8 = 0;
/// Typed bytes kept while the guest does not read; what comes beyond is refused.
const PENDING_MAX: usize = 4096;

/// An interrupt line behind an eventfd.
#[derive(Debug)]
pub struct IrqLine(pub EventFd);

impl Trigger for IrqLine {
    type E = std::io::Error;

    fn trigger(&self) -> std::io::Result<()> {
        self.0.write(1)
    }
}

struct Port<W: ConsoleOutput> {
    registers: Serial<IrqLine, NoEvents, W>,
    pending: VecDeque<u8>,
}

impl<W: ConsoleOutput> Port<W> {
    fn refill(&mut self) {
        let room = self.registers.fifo_capacity().min(self.pending.len());
        if room > 0 {
            let bytes: Vec<u8> = self.pending.drain(..room).collect();
            // Fails if there is no room, which was just asked, or in loop-back mode, where a real
            // port would not see the bytes either.
            let _ = self.registers.enqueue_raw_bytes(&bytes);
        }
    }
}

/// A serial port, shared by the thread of its guest and the thread that types.
pub struct SerialPort<W: ConsoleOutput>(Arc<Mutex<Port<W>>>);

impl<W: ConsoleOutput> Clone for SerialPort<W> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<W: ConsoleOutput> SerialPort<W> {
    /// A port that raises `irq` and writes what the guest sends to `out`.
    pub fn new(irq: IrqLine, out: W) -> Self {
        let registers = Serial::new(irq, out);
        Self(Arc::new(Mutex::new(Port { registers, pending: VecDeque::new() })))
    }

    /// Brings bytes to the guest. Returns how many were taken; the caller keeps the rest.
    ///
    /// Never waits for the guest's thread, which may hold the port at this moment.
    pub fn type_bytes(&self, bytes: &[u8]) -> usize {
        let mut port = match self.0.try_lock() {
            Ok(port) => port,
            Err(TryLockError::Poisoned(port)) => port.into_inner(),
            Err(TryLockError::WouldBlock) => return 0,
        };
        let room = PENDING_MAX.saturating_sub(port.pending.len()).min(bytes.len());
        port.pending.extend(&bytes[..room]);
        port.refill();
        room
    }

    /// The registers as at power-on, as far as a driver can tell, and nothing typed.
    pub fn reset(&self) {
        /// Offsets of registers; `INTERRUPTS` while the divisor latch is closed.
        const INTERRUPTS: u8 = 1;
        const LINE_CONTROL: u8 = 3;
        const MODEM_CONTROL: u8 = 4;
        const LINE_STATUS: u8 = 5;
        const DATA_READY: u8 = 1;

        let mut port = self.lock();
        port.pending.clear();
        port.registers.writer_mut().begin_anew();
        for register in [LINE_CONTROL, MODEM_CONTROL, INTERRUPTS] {
            // Only an interrupt can fail, and a new machine does not know of one.
            let _ = port.registers.write(register, 0);
        }
        while port.registers.read(LINE_STATUS) & DATA_READY != 0 {
            port.registers.read(DATA);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Port<W>> {
        // No access can leave the registers half-changed, so a poisoned lock is still good.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<W: ConsoleOutput + Send> PortDevice for SerialPort<W> {
    fn read(&mut self, offset: u16, data: &mut [u8]) {
        data.fill(0xff);
        if let (Ok(offset), [value]) = (u8::try_from(offset), data) {
            let mut port = self.lock();
            *value = port.registers.read(offset);
            port.refill();
        }
    }

    fn write(&mut self, offset: u16, data: &[u8]) {
        if let (Ok(offset), &[value]) = (u8::try_from(offset), data) {
            // An error means that the output is gone because the run is ending, or that the
            // interrupt's counter is full, in which case it is pending anyway.
            let _ = self.lock().registers.write(offset, value);
        }
    }

    fn would_wait(&self, offset: u16, bytes: usize) -> bool {
        offset == u16::from(DATA) && self.lock().registers.writer().would_wait(bytes)
    }
}

#[cfg(test)]
#[path = "serial_tests.rs"]
mod tests;
