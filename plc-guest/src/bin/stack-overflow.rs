//! A guest that runs well for 100 cycles and then recurses without end.
//!
//! It shows that the page below the stack and the separate exception stacks turn an overflow into
//! a reported fault, where it would otherwise end in a triple fault or in silence.

#![no_std]
#![no_main]

use core::hint::black_box;
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::entry;

const GOOD_CYCLES: u32 = 100;

struct StackOverflow {
    cycles: u32,
}

impl Program for StackOverflow {
    fn scan(&mut self, _: &Cycle) {
        if self.cycles == GOOD_CYCLES {
            black_box(recurse(0));
        }
        self.cycles += 1;
    }
}

/// The local array and the addition after the call keep this from becoming a loop.
#[allow(unconditional_recursion)]
fn recurse(depth: u64) -> u64 {
    let local = black_box([depth; 8]);
    recurse(depth.wrapping_add(1)).wrapping_add(local[0])
}

fn main() -> ! {
    print(format_args!("stack-overflow, {GOOD_CYCLES} good cycles"));
    cycle::run(StackOverflow { cycles: 0 })
}

entry!(main);
