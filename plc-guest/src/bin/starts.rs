//! A guest that counts its starts: once where a warm start keeps the count, and once where no start
//! does.
//!
//! It shows what a warm and a cold start keep, and that a guest is told which of them it was.

#![no_std]
#![no_main]

use core::sync::atomic::{AtomicU32, Ordering};
use takt_abi::start::WARM;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

#[unsafe(link_section = ".retain")]
static RETAINED: AtomicU32 = AtomicU32::new(0);
static FORGOTTEN: AtomicU32 = AtomicU32::new(0);

struct Starts;

impl Program for Starts {
    fn scan(&mut self, cycle: &Cycle) {
        if cycle.elapsed.is_zero() {
            let information = pages::information();
            let gap = information.next_release_tsc.saturating_sub(information.release_tsc);
            print(format_args!(
                "scan under schedule {}, next release {} us later",
                information.schedule,
                gap * 1000 / information.tsc_khz.max(1),
            ));
        }
    }
}

fn main() -> ! {
    let information = pages::information();
    print(format_args!(
        "{} start, condition {}, retained {}, forgotten {}",
        if information.start_mode == WARM { "warm" } else { "cold" },
        information.start_condition,
        RETAINED.fetch_add(1, Ordering::Relaxed),
        FORGOTTEN.fetch_add(1, Ordering::Relaxed),
    ));
    cycle::run(Starts)
}

entry!(main);
