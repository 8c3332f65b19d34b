//! RETAIN and PERSISTENT values of control programs, as they are kept over a stop of Takt.
//!
//! A [`Layout`] says which bytes of a program's state are kept: its *block* is those bytes, one variable behind the
//! other. The kernel of a PLC copies a block between two jobs, so its values are of one cycle. A [`Generation`] is a block as it lies
//! in a file: each value with its name and type, a number, and a checksum over all of it. A [`Store`] has two files
//! and writes them in turn, so the newest generation that was written whole is never written over. What a program
//! finds at a start is worked out by [`Layout::restore`].
//!
//! Whatever a file contains is hostile: it is bounded, and its checksum comes before anything else. There is no clock, no
//! thread and no guest here.

#![forbid(unsafe_code)]

mod generation;
mod layout;
mod restore;
mod store;

pub use generation::{Damage, Entry, Generation, LENGTH_MAX};
pub use layout::{Layout, Part};
pub use restore::Restored;
pub use store::{Found, Store};
