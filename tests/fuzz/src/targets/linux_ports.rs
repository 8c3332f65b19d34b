//! All that a Linux guest can do to the I/O ports of its machine.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use takt_devices::output;
use takt_devices::pci::config_ports::ConfigPorts;
use takt_devices::pci::function::{Bars, Function};
use takt_devices::ports::PortBus;
use takt_devices::power::{AcpiPower, KeyboardController, PowerLine};
use takt_devices::serial::{IrqLine, PORTS, SerialPort};
use vmm_sys_util::eventfd::{EFD_NONBLOCK, EventFd};

/// Bytes that one access may move: a string instruction moves up to a page.
const LONGEST: usize = 64;

/// Makes one access after the other: a byte for direction and width, two for the port, one for the
/// length, then what is written.
///
/// # Panics
/// If a device leaves its ports, or answers more than it was asked for.
pub fn run(mut data: &[u8]) {
    // With its stop set, a full ring is an error and the writer does not wait.
    let (text, mut end) = output::waiting(Arc::new(AtomicBool::new(true)));
    let irq = IrqLine(EventFd::new(EFD_NONBLOCK).expect("an eventfd"));
    let console = SerialPort::new(irq, text);
    let power = PowerLine::default();
    let bars = Bars::assign(&(0xd000_0000..=0xdfff_ffff), 1 << 20, 1 << 16).expect("room");
    let mut bus = PortBus::default();
    let attached = [
        bus.attach(0x3f8..=0x3f8 + PORTS - 1, Box::new(console.clone())),
        bus.attach(0x600..=0x602, Box::new(AcpiPower(power.clone()))),
        bus.attach(0x60..=0x64, Box::new(KeyboardController::new(power))),
        bus.attach(0xcf8..=0xcff, Box::new(ConfigPorts::new(Function::new(bars)))),
    ];
    assert!(attached.iter().all(Result::is_ok));

    let mut drained = Vec::new();
    while let [what, low, high, length, rest @ ..] = data {
        let (port, width) = (u16::from_le_bytes([*low, *high]), 1 << (what >> 1 & 3));
        let length = (usize::from(*length) % LONGEST).min(rest.len());
        let (bytes, after) = rest.split_at(length);
        data = after;
        if what & 1 == 0 {
            bus.write(port, width, bytes);
        } else {
            bus.read(port, width, &mut [0; LONGEST][..length]);
        }
        if what & 0x80 != 0 {
            console.type_bytes(bytes);
        }
        if what & 0x40 != 0 {
            end.drain_into(&mut drained);
            drained.clear();
        }
    }
}
