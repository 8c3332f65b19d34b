//! The kernel of a PLC that runs program images: a guest of Takt.
//!
//! What it decides is in the library of this package, which knows no processor; this binary carries it
//! out. `docs/kernel.md` describes both.

#![no_std]
#![no_main]

mod machine;

use core::cell::UnsafeCell;
use machine::kernel::Kernel;
use takt_plc_guest::entry;

struct Place(UnsafeCell<Kernel>);

// SAFETY: there is one thread, and only `main` looks at it.
unsafe impl Sync for Place {}

/// All of the kernel's state: too large for its stack.
static KERNEL: Place = Place(UnsafeCell::new(Kernel::EMPTY));

fn main() -> ! {
    // SAFETY: `main` is called once.
    let kernel = unsafe { &mut *KERNEL.0.get() };
    kernel.start()
}

entry!(main);
