//! What a load says of itself while the releases beside it are measured.
//!
//! A figure under load counts only if there was a load, so a measurement records its progress. The
//! load is a program in the Linux guest, and its console is all that Takt sees of it. Takt stamps the
//! lines, because a reader outside of the appliance has the text and not the time, and a
//! guest's own clock is of no use once the guest has stopped. What follows from the progress
//! is for `takt jitter` to say; here it is only kept, and only if `takt run --samples` asks for it.

pub mod line;
pub mod recorder;

pub use line::{Lines, Word};
pub use recorder::{Course, POINTS_MAX, Recorder, Standstill};
