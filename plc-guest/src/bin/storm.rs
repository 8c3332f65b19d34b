//! A hostile guest: a device that never stops asking, and a program that never stops letting it.
//!
//! The device is QEMU's `edu`, as in the guest `interrupts`. It is told to ask for an interrupt once and
//! is never acknowledged. Each window is filled with requests for the next interrupt, up to its end
//! and beyond.

#![no_std]
#![no_main]

use takt_abi::memory;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle;
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{entry, interrupt, pages, port};

const VECTOR: u8 = 64;
const RAISE: u64 = 0x60;
/// Exit code if there is no room for registers.
const NO_REGISTER: u32 = 2;
/// Releases between two lines.
const REPORT: u64 = 500;

fn main() -> ! {
    let Some(raise) = Register::<u32>::at(memory::DEVICES + RAISE) else { port::exit(NO_REGISTER) };
    raise.write(1);
    let (mut arrived, mut next) = (0u64, REPORT);
    loop {
        interrupt::arm(VECTOR);
        arrived += u64::from(interrupt::taken(VECTOR));
        let release = pages::information().release;
        if release >= next {
            next = release + REPORT;
            print(format_args!("release {release}, arrived {arrived}, tsc {}", cycle::now()));
        }
    }
}

entry!(main);
