//! A guest that computes for a tenth of its window, but for some scans that take much longer, and one
//! that leaves the guest several times.
//!
//! It shows whether a report names the cause of what it measures.

#![no_std]
#![no_main]

use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

/// The scans that compute for four tenths of their windows. A host's tick falls into some of a few
/// in a row at most, and is then the likelier cause.
const LONG: core::ops::RangeInclusive<u32> = 700..=703;
/// The scan that prints lines, and how many.
const TALKATIVE: u32 = 900;
const LINES: u32 = 8;

#[derive(Default)]
struct Disturbed {
    scans: u32,
}

impl Program for Disturbed {
    fn scan(&mut self, _: &Cycle) {
        let page = pages::information();
        let tenth = page.window_end_tsc.saturating_sub(page.release_tsc) / 10;
        self.scans = self.scans.saturating_add(1);
        let length = if LONG.contains(&self.scans) { 4 * tenth } else { tenth };
        let end = cycle::now() + length;
        while cycle::now() < end {}
        if self.scans == TALKATIVE {
            for line in 1..=LINES {
                print(format_args!("disturbed, line {line} of {LINES}"));
            }
        }
    }
}

fn main() -> ! {
    print(format_args!("disturbed, scans {LONG:?} take long and scan {TALKATIVE} talks"));
    cycle::run(Disturbed::default())
}

entry!(main);
