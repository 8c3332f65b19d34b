//! A guest that runs for 100 cycles and then fails, in one way after a cold start and in another
//! after a warm one.
//!
//! With a table that answers the one by a warm start and the other by a cold start, its starts
//! alternate.

#![no_std]
#![no_main]

use core::arch::asm;
use takt_abi::start::WARM;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

const GOOD_CYCLES: u32 = 100;

struct Failing {
    cycles: u32,
    warm: bool,
}

impl Program for Failing {
    fn scan(&mut self, _: &Cycle) {
        if self.cycles == GOOD_CYCLES {
            // SAFETY: both raise an exception, from which the handler does not return.
            unsafe {
                if self.warm {
                    asm!("ud2");
                }
                asm!("div {:e}", in(reg) 0_u32, inout("eax") 1_u32 => _, inout("edx") 0_u32 => _);
            }
        }
        self.cycles += 1;
    }
}

fn main() -> ! {
    cycle::run(Failing { cycles: 0, warm: pages::information().start_mode == WARM })
}

entry!(main);
