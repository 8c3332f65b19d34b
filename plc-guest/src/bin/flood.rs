//! A guest that floods the host: in each cycle 100 console lines, and 50 accesses to ports that it
//! does not own.
//!
//! It shows that a console is bounded by the host and that illegal port accesses are counted and
//! survived, however many come.

#![no_std]
#![no_main]

use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, port};

const LINES: u32 = 100;
/// No port of the interface, and none that a machine would usually have.
const FOREIGN_PORTS: core::ops::Range<u16> = 0x2000..0x2032;

struct Flood;

impl Program for Flood {
    fn scan(&mut self, cycle: &Cycle) {
        for line in 0..LINES {
            print(format_args!("flood, cycle {}, line {line}", cycle.release));
        }
        for foreign in FOREIGN_PORTS {
            if foreign % 2 == 0 {
                port::write(foreign, u32::MAX);
            } else {
                // What the host gives for a port that is not there is not this guest's subject.
                let _ = port::read(foreign);
            }
        }
    }
}

fn main() -> ! {
    print(format_args!(
        "flood, {LINES} lines and {} foreign port accesses a cycle",
        FOREIGN_PORTS.len()
    ));
    cycle::run(Flood)
}

entry!(main);
