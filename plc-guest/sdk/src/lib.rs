//! Writes control programs for Takt in Rust.
//!
//! A program is a `no_std` static library. It declares its tasks, points and kernel objects with the macros
//! of this crate; `takt plc build` makes a program image of it.
//!
//! ```ignore
//! #![no_std]
//! use takt_sdk::{Cyclic, Job, ms};
//!
//! takt_sdk::program!("tank", 1, 0, 0);
//! takt_sdk::input!(LEVEL: f32, "level", 0);
//! takt_sdk::output!(VALVE: f32, "valve", 0);
//! takt_sdk::task!("control", control, Cyclic { period: ms(10), ..Cyclic::DEFAULT });
//!
//! fn control(_job: &Job) {
//!     VALVE.set(if LEVEL.get() < 2.0 { 1.0 } else { 0.0 });
//! }
//! ```
//!
//! There is no allocator and there are no threads. Tasks of one program can interrupt each other: what
//! they share is a [`Point`], a kernel object, or a [`Local`] that refuses a second user.

#![cfg_attr(not(test), no_std)]

// The flags of a build hold for this crate, too, so they are found before anything is linked.
#[cfg(all(feature = "runtime", target_feature = "avx", not(test)))]
compile_error!(
    "this build makes instructions of AVX, which the PLC's kernel does not give to programs; \
     build without `target-cpu=native` and `target-feature=+avx` (RUSTFLAGS, .cargo/config.toml)"
);

pub mod call;
pub mod declaration;
mod job;
#[doc(hidden)]
pub mod line;
mod local;
mod macros;
mod object;
mod point;
#[cfg(all(feature = "runtime", not(test)))]
mod runtime;
mod task;
mod text;
mod time;

pub use call::Error;
pub use job::Job;
pub use local::Local;
pub use object::{Flags, Mailbox, PortIn, PortOut, Queue, Semaphore};
pub use point::{Input, InputBit, Marker, Output, OutputBit, Point, Value};
pub use task::{Cyclic, Event, Freewheeling, Schedule};
pub use text::Text;
pub use time::Time;

/// Milliseconds as nanoseconds.
#[must_use]
pub const fn ms(milliseconds: u64) -> u64 {
    milliseconds * 1_000_000
}

/// Microseconds as nanoseconds.
#[must_use]
pub const fn us(microseconds: u64) -> u64 {
    microseconds * 1_000
}
