//! A guest that computes for a tenth of its window and then gives the rest away.
//!
//! It shows what becomes of the time that a partition leaves.

#![no_std]
#![no_main]

use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{entry, pages};

struct Tenth;

impl Program for Tenth {
    fn scan(&mut self, _: &Cycle) {
        let page = pages::information();
        let end = page.release_tsc + page.window_end_tsc.saturating_sub(page.release_tsc) / 10;
        while cycle::now() < end {}
    }
}

fn main() -> ! {
    print(format_args!("tenth, computes for a tenth of each window"));
    cycle::run(Tenth)
}

entry!(main);
