//! A guest that has ports and breaks every rule about them: in each cycle it writes nonsense to
//! some place of the pages that are its own, and now and then to one that is not.
//!
//! It shows what the other end of a channel has to expect: wrong data or none, and nothing worse.

#![no_std]
#![no_main]

use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::{channel, entry};

/// Words written in a cycle.
const WRITES: u32 = 200;
const PAGE: u64 = 4096;

/// A generator of George Marsaglia's (xorshift64): its numbers are the same in each run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

struct Hostile {
    random: Random,
}

impl Program for Hostile {
    fn scan(&mut self, _: &Cycle) {
        for port in channel::ports() {
            for _ in 0..WRITES {
                // Headers and counters more often than what lies behind them.
                let all = u64::from(port.own_pages) * PAGE / 8;
                let words = if self.random.next().is_multiple_of(2) { 32 } else { all };
                let address = port.own + (self.random.next() % words.max(1)) * 8;
                let value = match self.random.next() % 4 {
                    0 => 0,
                    1 => u64::MAX,
                    2 => self.random.next() % 64,
                    _ => self.random.next(),
                };
                if port.own != 0 {
                    // SAFETY: the page is mapped writable, and nothing in this guest relies on
                    // what is in it.
                    unsafe { (address as *mut u64).write_volatile(value) };
                }
            }
        }
    }
}

fn main() -> ! {
    print(format_args!("hostile-peer, {WRITES} wrong words a cycle and port"));
    cycle::run(Hostile { random: Random(0x9e37_79b9_7f4a_7c15) })
}

entry!(main);
