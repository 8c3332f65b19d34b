//! A guest that lets a device interrupt it, and looks whether each interrupt arrives.
//!
//! The device is QEMU's `edu`, whose registers are the first memory of devices and whose interrupt has
//! the vector 64. In each scan the guest lets it interrupt, unless the last interrupt has not come
//! yet. The first time, it ends itself in the middle of that: the next one has to find a controller in
//! which nothing is left of this one.

#![no_std]
#![no_main]

use takt_abi::{memory, start};
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{entry, interrupt, pages, port};

const VECTOR: u8 = 64;
/// Registers of `edu` (QEMU's `docs/specs/edu.txt`): what it asks for an interrupt for, what makes it
/// ask, and what ends that.
const STATUS: u64 = 0x24;
const RAISE: u64 = 0x60;
const ACKNOWLEDGE: u64 = 0x64;
/// Exit code if there is no room for registers.
const NO_REGISTER: u32 = 2;
/// Scans between two lines.
const REPORT: u64 = 500;
/// Scans after which the first guest ends itself.
const FIRST_LIFE: u64 = 250;

struct Interrupts {
    /// This is the first start.
    first: bool,
    status: Register<u32>,
    raise: Register<u32>,
    acknowledge: Register<u32>,
    scans: u64,
    raised: u32,
    arrived: u32,
    /// Interrupts for which the device had another reason, or none.
    wrong: u32,
    /// Release at which the device was told to ask.
    since: u64,
    /// Scans from there to the interrupt: the fewest and the most.
    fewest: u64,
    most: u64,
    /// Least ticks of a look that finds nothing, and of one that finds something.
    nothing: u64,
    something: u64,
}

impl Program for Interrupts {
    fn scan(&mut self, cycle: &Cycle) {
        let before = cycle::now();
        let taken = interrupt::taken(VECTOR);
        let ticks = cycle::now().saturating_sub(before);
        if taken {
            self.something = self.something.min(ticks);
            self.arrived += 1;
            self.wrong += u32::from(self.status.read() != self.raised);
            self.acknowledge.write(self.raised);
            let scans = cycle.release.saturating_sub(self.since);
            self.fewest = self.fewest.min(scans);
            self.most = self.most.max(scans);
            interrupt::arm(VECTOR);
        } else {
            self.nothing = self.nothing.min(ticks);
        }
        if self.arrived == self.raised {
            self.raised += 1;
            self.since = cycle.release;
            self.raise.write(self.raised);
        }
        self.scans += 1;
        if self.first && self.scans == FIRST_LIFE {
            port::exit(0);
        }
        if self.scans.is_multiple_of(REPORT) {
            print(format_args!(
                "raised {}, arrived {}, wrong {}, after {} to {} scans; ticks {} and {}",
                self.raised,
                self.arrived,
                self.wrong,
                self.fewest,
                self.most,
                self.nothing,
                self.something,
            ));
        }
    }
}

fn main() -> ! {
    let register = |offset| Register::<u32>::at(memory::DEVICES + offset);
    let (Some(status), Some(raise), Some(acknowledge)) =
        (register(STATUS), register(RAISE), register(ACKNOWLEDGE))
    else {
        port::exit(NO_REGISTER)
    };
    // What the guest before this one has left.
    acknowledge.write(status.read());
    interrupt::arm(VECTOR);
    cycle::run(Interrupts {
        first: pages::information().start_condition == start::NORMAL,
        status,
        raise,
        acknowledge,
        scans: 0,
        raised: 0,
        arrived: 0,
        wrong: 0,
        since: 0,
        fewest: u64::MAX,
        most: 0,
        nothing: u64::MAX,
        something: u64::MAX,
    })
}

entry!(main);
