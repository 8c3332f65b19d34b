//! The PLC guest of Takt: what a control program needs between the bare vCPU and its scan.
//!
//! Takt starts a PLC partition in long mode with nothing around it: no firmware, no interrupt
//! controller, no operating system. This crate is the rest. It takes the processor into a state in
//! which a stray pointer or an endless recursion is *reported* instead of corrupting the control
//! program ([`boot`], [`exception`], [`paging`]), and it runs a [`cycle::Program`] once per release
//! of the schedule ([`cycle`]).
//!
//! There is no allocator and no second thread, and no interrupt but at the moment at which a program
//! looks for one ([`interrupt`]): the schedule of the host is the only scheduler, so a guest has
//! nothing to lock and its worst case is the worst case of one scan.
//!
//! A guest is a binary of a few lines that names its main function with [`entry!`].
//!
//! Modules that contain no privileged instruction are also compiled for the host's test harness;
//! the others only exist in a guest.

#![cfg_attr(not(test), no_std)]

#[cfg(not(test))]
pub mod boot;
pub mod can;
pub mod channel;
pub mod console;
pub mod control;
pub mod cycle;
#[cfg(not(test))]
pub mod descriptor;
#[cfg(not(test))]
pub mod exception;
pub mod health;
#[cfg(not(test))]
pub mod interrupt;
pub mod io;
#[cfg(not(test))]
mod language;
pub mod mmio;
pub mod pages;
pub mod paging;
pub mod port;
pub mod sequence;
#[cfg(not(test))]
mod stack;

/// Names the main function of a guest, a `fn() -> !`. It is called once, after [`boot`].
#[macro_export]
macro_rules! entry {
    ($main:path) => {
        // SAFETY: `boot` declares this symbol with the same signature, and a binary that defines
        // it twice does not link.
        #[unsafe(no_mangle)]
        extern "Rust" fn takt_guest_main() -> ! {
            let main: fn() -> ! = $main;
            main()
        }
    };
}
