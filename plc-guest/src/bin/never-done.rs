//! A guest whose scan never ends and never leaves guest mode: only a kick can stop it.
//!
//! It shows the end of a window. It stores the time stamp counter in `Status::done_tsc` for ever,
//! so the host finds there the last moment at which the guest really ran.

#![no_std]
#![no_main]

use takt_plc_guest::console::print;
use takt_plc_guest::{cycle, entry, pages};

fn main() -> ! {
    print(format_args!("never-done, one scan without end"));
    let (information, start) = cycle::wait();
    pages::publish_start(information.release, start);
    loop {
        pages::publish_done(cycle::now());
    }
}

entry!(main);
