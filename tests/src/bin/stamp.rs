//! Prints the time of day beside the TSC, which guests and host of Takt share: two such lines, wherever they were
//! printed, say how far two clocks are from each other.
//!
//!     stamp NAME        prints "stamp NAME TSC NANOSECONDS", from the closest of some tries

use std::arch::x86_64::_rdtsc;
use std::time::{SystemTime, UNIX_EPOCH};

/// So that no interrupt lies between the two looks of the best.
const TRIES: usize = 100;

fn main() {
    let name = std::env::args().nth(1).unwrap_or_default();
    let tries = (0..TRIES).map(|_| {
        // SAFETY: every processor that Takt runs on has the instruction, and it changes no memory.
        let before = unsafe { _rdtsc() };
        let now = SystemTime::now();
        // SAFETY: as above.
        let after = unsafe { _rdtsc() };
        (after - before, before + (after - before) / 2, now)
    });
    let Some((_, tsc, now)) = tries.min() else { return };
    let since = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    println!("stamp {name} {tsc} {}", since.as_nanos());
}
