//! A guest that runs well for 100 cycles and then writes through a null pointer.
//!
//! It shows that an exception reaches the host with its vector and address, and that it ends this
//! guest only.

#![no_std]
#![no_main]

use core::arch::asm;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::entry;

const GOOD_CYCLES: u32 = 100;

struct Fault {
    cycles: u32,
}

impl Program for Fault {
    fn scan(&mut self, _: &Cycle) {
        if self.cycles == GOOD_CYCLES {
            // SAFETY: page 0 is not mapped, so the store changes nothing; it raises a page fault,
            // from which the handler does not return. Assembly, because a null store in Rust would
            // be undefined.
            unsafe { asm!("mov qword ptr [{}], 0", in(reg) 0_u64, options(nostack)) };
        }
        self.cycles += 1;
    }
}

fn main() -> ! {
    print(format_args!("fault, {GOOD_CYCLES} good cycles"));
    cycle::run(Fault { cycles: 0 })
}

entry!(main);
