//! What is counted and measured in a run, and the forms in which it is told.
//!
//! The input is the records of windows ([`takt_record`]) and what consoles say; the output is the
//! [`report`], the [`samples`] and the [`trace`]. Their writers and their readers use the same types,
//! so that a schema is written once. Nothing here makes a system call.

mod bins;
pub mod cause;
pub mod load;
pub mod report;
pub mod samples;
pub mod statistics;
pub mod trace;
pub mod worst;
