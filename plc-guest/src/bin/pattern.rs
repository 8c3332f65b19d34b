//! A guest that fills memory with a pattern and looks, a piece in each scan, whether it is still there:
//! the neighbour of one whose device tries to write where it must not.

#![no_std]
#![no_main]

use core::ptr;

use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::entry;

const WORDS: usize = 64 << 10;
/// Words that are looked at in a scan.
const PIECE: usize = 1 << 10;

static mut PATTERN: [u32; WORDS] = [0; WORDS];

struct Pattern {
    place: usize,
    passes: u32,
    changed: u32,
}

fn word(place: usize) -> *mut u32 {
    // SAFETY: inside the array, since the place is taken modulo its length.
    unsafe { (&raw mut PATTERN).cast::<u32>().add(place % WORDS) }
}

fn expected(place: usize) -> u32 {
    (place as u32).wrapping_mul(0x9e37_79b9)
}

impl Program for Pattern {
    fn scan(&mut self, _: &Cycle) {
        for place in self.place..self.place + PIECE {
            // SAFETY: aligned and inside the array; volatile, since it is others that would change it.
            let found = unsafe { word(place).read_volatile() };
            self.changed += u32::from(found != expected(place));
        }
        self.place += PIECE;
        if self.place == WORDS {
            self.place = 0;
            self.passes += 1;
            print(format_args!("passes {}, changed {}", self.passes, self.changed));
        }
    }
}

fn main() -> ! {
    for place in 0..WORDS {
        // SAFETY: aligned and inside the array.
        unsafe { ptr::write_volatile(word(place), expected(place)) };
    }
    cycle::run(Pattern { place: 0, passes: 0, changed: 0 })
}

entry!(main);
