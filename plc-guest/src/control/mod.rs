//! Control blocks of the demonstration program: pure state machines over elapsed time.
//!
//! None of them looks at a clock or a port. Time is an argument, so a block gives the same answer
//! in a guest, in a unit test, and after lost cycles.

pub mod blinker;
pub mod pid;
pub mod tank;
