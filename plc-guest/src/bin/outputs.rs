//! A guest that drives real outputs, and counts what that costs in ticks of the TSC.
//!
//! In each cycle it prints the number of the scan, modulo 256, on a parallel port (0x378): a byte
//! into the data register and a pulse on the strobe line. It also writes a register of device
//! memory, if the partition has an `edu` device of QEMU's there, which gives the complement back.

#![no_std]
#![no_main]

use takt_abi::memory;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::io::outb;
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{entry, port};

const DATA: u16 = 0x378;
const CONTROL: u16 = 0x37a;
/// Control register (IEEE 1284-2000, "compatibility mode"): printer selected and not reset, and
/// then the strobe too.
const IDLE: u8 = 0x0c;
const STROBE: u8 = 0x0d;
/// Identification and "card liveness check" of QEMU's `edu` (its `docs/specs/edu.txt`).
const EDU: u32 = 0x0100_00ed;
const LIVENESS: u64 = 4;
/// Scans until the costs are printed.
const SCANS: u32 = 100;
/// Exit code if there is no room for registers.
const NO_REGISTER: u32 = 2;

/// The least that something took.
struct Least(u64);

impl Least {
    fn measure(&mut self, what: impl FnOnce()) {
        let before = cycle::now();
        what();
        self.0 = self.0.min(cycle::now().saturating_sub(before));
    }
}

struct Outputs {
    scans: u32,
    liveness: Register<u32>,
    has_edu: bool,
    wrong: u32,
    nothing: Least,
    port: Least,
    register: Least,
}

impl Program for Outputs {
    fn scan(&mut self, _: &Cycle) {
        let byte = self.scans as u8;
        self.nothing.measure(|| ());
        self.port.measure(|| outb(DATA, byte));
        outb(CONTROL, IDLE);
        outb(CONTROL, STROBE);
        outb(CONTROL, IDLE);
        if self.has_edu {
            let (liveness, scans) = (&self.liveness, self.scans);
            self.register.measure(|| liveness.write(scans));
            self.wrong += u32::from(self.liveness.read() != !self.scans);
        }
        self.scans += 1;
        if self.scans == SCANS {
            let beyond = |least: &Least| least.0.saturating_sub(self.nothing.0);
            print(format_args!("ticks of a write to a port: {}", beyond(&self.port)));
            if self.has_edu {
                let ticks = beyond(&self.register);
                print(format_args!(
                    "ticks of a write to a register: {ticks}, {} wrong",
                    self.wrong
                ));
            }
        }
    }
}

fn main() -> ! {
    let registers =
        (Register::<u32>::at(memory::DEVICES), Register::<u32>::at(memory::DEVICES + LIVENESS));
    let (Some(identification), Some(liveness)) = registers else { port::exit(NO_REGISTER) };
    let least = || Least(u64::MAX);
    cycle::run(Outputs {
        scans: 0,
        liveness,
        has_edu: identification.read() == EDU,
        wrong: 0,
        nothing: least(),
        port: least(),
        register: least(),
    })
}

entry!(main);
