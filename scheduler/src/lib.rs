//! The time-window schedule, which is what Takt exists for.
//!
//! The crate has two halves with a hard line between them:
//!
//! * [`time`], [`table`], [`schedules`], [`timetable`], [`switch`], [`quiet`], [`close`], [`guard`], [`reservation`] and
//!   [`analysis`] are arithmetic over values: no clock is read, no call is made, so every rule can be tested
//!   exhaustively and the same code answers `takt check` and drives the running system. "Now" is always an argument.
//! * [`enforce`], [`moment`] and [`sleep`] (with [`rest`]) are the thin layer that turns it into kernel calls:
//!   pinning, SCHED_DEADLINE, both clocks, and the absolute sleep on the TSC.

pub mod analysis;
pub mod close;
pub mod enforce;
pub mod guard;
pub mod moment;
pub mod quiet;
pub mod reservation;
pub mod rest;
pub mod schedules;
pub mod sleep;
pub mod switch;
pub mod table;
pub mod time;
pub mod timetable;
