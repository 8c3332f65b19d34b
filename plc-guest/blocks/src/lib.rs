//! Function blocks for control programs.
//!
//! A program calls each of its blocks once in a scan, with the time that has passed since the last
//! call. No block looks at a clock or a port, allocates, or waits. Thus a block gives the same answer in
//! a PLC, in a unit test, and after lost cycles.
//!
//! Three rules hold for all of them:
//!
//! - **State is plain data.** Each block is `repr(C)`, `Copy` and has a `Default`, so an online change
//!   can move it and the C header `blocks.h` has the same structures. The default is the state after a
//!   cold start, unless the block says otherwise.
//! - **Time is measured, not assumed.** What depends on time takes `elapsed`. If it is zero nothing
//!   moves, and if it is long the result is the one of a long cycle: finite, and within the limits.
//! - **A number that is not finite stays out of the state.** One NaN in an integrator would stay there
//!   forever. A block with memory ignores such an input and keeps its output. A block without memory
//!   hands a NaN on. Exceptions are stated at the block.
//!
//! `docs/blocks.md` has the table of all blocks, with inputs, outputs, formula and reference.

#![no_std]

pub mod alarm;
pub mod biquad;
pub mod bistable;
pub mod counter;
pub mod dead_band;
pub mod delay;
pub mod edge;
pub mod fft;
pub mod fir;
pub mod hysteresis;
pub mod lag;
pub mod limit;
mod math;
pub mod multiplexer;
pub mod pid;
pub mod ramp;
pub mod scale;
pub mod second_order;
pub mod statistics;
mod time;
pub mod timer;

pub use alarm::{Alarm, AlarmState, Condition};
pub use biquad::{Biquad, Coefficients};
pub use bistable::{Rs, Sr};
pub use counter::{Ctd, Ctu, Ctud};
pub use dead_band::DeadBand;
pub use delay::Delay;
pub use edge::{FTrig, RTrig};
pub use fir::Fir;
pub use hysteresis::Hysteresis;
pub use lag::Lag;
pub use limit::Limiter;
pub use multiplexer::Multiplexer;
pub use pid::{Pid, Tuning};
pub use ramp::Ramp;
pub use scale::Scale;
pub use second_order::SecondOrder;
pub use statistics::Statistics;
pub use timer::{Tof, Ton, Tp};
