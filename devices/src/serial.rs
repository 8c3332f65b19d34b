//! The serial port that is the Linux guest's console.
//!
//! The registers are vm-superio's. What is added here: the lock between the vCPU thread, which
//! makes the guest's accesses, and the event thread, which brings what was typed; and a queue for
//! typed bytes that the 16-byte-deep view of the guest has no room for yet.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;

use vm_superio::serial::NoEvents;
use vm_superio::{Serial, Trigger};
use vmm_sys_util::eventfd::EventFd;

use crate::output::{ConsoleOutput, RETRY};
use crate::ports::PortDevice;

/// Number of I/O ports of a 16550.
pub const PORTS: u16 = 8;
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
        /// Offsets of registers; `DATA` and `INTERRUPTS` while the divisor latch is closed.
        const DATA: u8 = 0;
        const INTERRUPTS: u8 = 1;
        const LINE_CONTROL: u8 = 3;
        const MODEM_CONTROL: u8 = 4;
        const LINE_STATUS: u8 = 5;
        const DATA_READY: u8 = 1;

        let mut port = self.lock();
        port.pending.clear();
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
            let mut port = self.lock();
            // Not under the lock: what is typed has to get through, above all to a guest that prints
            // without end.
            while port.registers.writer().would_wait() {
                drop(port);
                thread::sleep(RETRY);
                port = self.lock();
            }
            // An error means that the output is gone because the run is ending, or that the
            // interrupt's counter is full, in which case it is pending anyway.
            let _ = port.registers.write(offset, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, Instant};

    use super::*;
    use crate::output;

    const DATA: u16 = 0;
    const INTERRUPT_ENABLE: u16 = 1;

    fn port() -> (SerialPort<Vec<u8>>, EventFd) {
        let irq = EventFd::new(vmm_sys_util::eventfd::EFD_NONBLOCK).unwrap();
        (SerialPort::new(IrqLine(irq.try_clone().unwrap()), Vec::new()), irq)
    }

    #[test]
    fn output_goes_out_in_order() {
        let (mut port, _irq) = port();
        for byte in b"Linux version" {
            port.write(DATA, &[*byte]);
        }
        assert_eq!(port.lock().registers.writer(), b"Linux version");
    }

    #[test]
    fn typed_bytes_arrive_in_order_also_beyond_the_fifo() {
        let (mut port, irq) = port();
        port.write(INTERRUPT_ENABLE, &[1]);
        let typed: Vec<u8> = (0..=255).cycle().take(1000).collect();
        assert_eq!(port.type_bytes(&typed), 1000);
        assert!(irq.read().is_ok());
        let mut value = [0];
        let seen: Vec<u8> = (0..1000)
            .map(|_| {
                port.read(DATA, &mut value);
                value[0]
            })
            .collect();
        assert_eq!(seen, typed);
    }

    #[test]
    fn a_guest_that_does_not_read_cannot_make_the_queue_grow() {
        let (port, _irq) = port();
        let taken: usize = (0..100).map(|_| port.type_bytes(&[0; 1000])).sum();
        assert!(taken <= PENDING_MAX + 64, "{taken}");
    }

    #[test]
    fn typing_does_not_wait_for_a_guest_that_holds_the_port() {
        let (port, _irq) = port();
        let held = port.clone();
        let guard = held.lock();
        assert_eq!(port.type_bytes(b"x"), 0);
        drop(guard);
        assert_eq!(port.type_bytes(b"x"), 1);
    }

    #[test]
    fn what_is_typed_gets_through_to_a_guest_that_waits_to_print() {
        let irq = EventFd::new(vmm_sys_util::eventfd::EFD_NONBLOCK).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (out, mut end) = output::waiting(stop.clone());
        let port = SerialPort::new(IrqLine(irq), out);
        let mut guest = port.clone();
        let prints = thread::spawn({
            let stop = stop.clone();
            move || {
                while !stop.load(Ordering::Relaxed) {
                    guest.write(DATA, b"y");
                }
            }
        });
        // Nobody takes it: from here on the guest waits.
        while !port.lock().registers.writer().would_wait() {
            thread::yield_now();
        }
        let begun = Instant::now();
        while port.type_bytes(b"\x03") == 0 {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing can be typed");
            thread::yield_now();
        }
        stop.store(true, Ordering::Relaxed);
        prints.join().unwrap();
        let mut printed = Vec::new();
        end.drain_into(&mut printed);
        assert!(printed.iter().all(|byte| *byte == b'y'));
    }

    #[test]
    fn a_reset_forgets_what_was_typed_and_what_a_guest_has_set() {
        const LINE_CONTROL: u16 = 3;
        const MODEM_CONTROL: u16 = 4;
        const LINE_STATUS: u16 = 5;
        const DIVISOR_LATCH: u8 = 0x80;
        const LOOP_BACK: u8 = 0x10;

        let (mut port, irq) = port();
        port.write(INTERRUPT_ENABLE, &[1]);
        port.type_bytes(&[7; 1000]);
        port.write(LINE_CONTROL, &[DIVISOR_LATCH]);
        port.write(MODEM_CONTROL, &[LOOP_BACK]);
        port.reset();
        let _ = irq.read();
        let mut value = [0];
        for (register, expected) in [(INTERRUPT_ENABLE, 0), (LINE_CONTROL, 0), (MODEM_CONTROL, 0)] {
            port.read(register, &mut value);
            assert_eq!(value, [expected], "{register}");
        }
        port.read(LINE_STATUS, &mut value);
        assert_eq!(value[0] & 1, 0, "data are ready");
        // The next guest's typing is its own, and interrupts nobody who has not asked for it.
        port.type_bytes(b"x");
        assert!(irq.read().is_err());
        port.read(DATA, &mut value);
        assert_eq!(&value, b"x");
    }

    #[test]
    fn any_sequence_of_accesses_is_survived() {
        let (mut port, _irq) = port();
        // A small linear congruential generator: a fixed sequence, no dependency.
        let mut state = 1u32;
        for _ in 0..100_000 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let (offset, value) = ((state >> 8) as u16, (state >> 24) as u8);
            let width = [1, 2, 4][(state >> 20) as usize % 3];
            if state & 0x8000_0000 == 0 {
                port.write(offset % 12, &[value; 4][..width]);
            } else {
                port.read(offset % 12, &mut [0; 4][..width]);
            }
            port.type_bytes(&[value]);
        }
    }
}
