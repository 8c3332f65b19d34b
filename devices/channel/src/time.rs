//! Instants and ages, in the only unit that all partitions share.
//!
//! Host and guests read one time-stamp counter, so a stamp can be compared wherever it is read.
//! This crate reads no clock and converts nothing: nanoseconds are the caller's business.

/// An instant: a raw value of the time-stamp counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Tsc(pub u64);

/// A number of ticks of the time-stamp counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticks(pub u64);

impl Tsc {
    /// Ticks from `earlier` to `self`; zero if `earlier` is in truth the later one.
    #[must_use]
    pub const fn since(self, earlier: Tsc) -> Ticks {
        Ticks(self.0.saturating_sub(earlier.0))
    }
}
