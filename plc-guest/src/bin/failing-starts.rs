//! A guest that counts its starts, reports an error, runs for 100 cycles and divides by zero.
//!
//! The count lies where a warm start keeps it. It shows what the health monitor makes of an error:
//! which start follows, that the guest is told of it, and that there is an end to it.

#![no_std]
#![no_main]

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering};
use takt_abi::start::WARM;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, health, pages};

const GOOD_CYCLES: u32 = 100;

#[unsafe(link_section = ".retain")]
static STARTS: AtomicU32 = AtomicU32::new(0);

struct Failing {
    cycles: u32,
}

impl Program for Failing {
    fn scan(&mut self, _: &Cycle) {
        if self.cycles == 0 {
            health::raise(7, "valve 3 does not follow");
        }
        if self.cycles == GOOD_CYCLES {
            // SAFETY: the division raises an exception, from which the handler does not return.
            // Assembly, because a division by zero in Rust is a panic.
            unsafe {
                asm!("div {:e}", in(reg) 0_u32, inout("eax") 1_u32 => _, inout("edx") 0_u32 => _);
            }
        }
        self.cycles += 1;
    }
}

fn main() -> ! {
    let information = pages::information();
    print(format_args!(
        "{} start, condition {}, retained {}",
        if information.start_mode == WARM { "warm" } else { "cold" },
        information.start_condition,
        STARTS.fetch_add(1, Ordering::Relaxed),
    ));
    cycle::run(Failing { cycles: 0 })
}

entry!(main);
