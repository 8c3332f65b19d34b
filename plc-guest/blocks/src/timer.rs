//! Timers `TP`, `TON` and `TOF`.
//!
//! The time of a call first passes, then the input is looked at: an edge of the input is taken to
//! happen at the call that sees it. `PT` is read in each call; the standard leaves open what a change of
//! it does while the timer runs.
//!
//! Reference: IEC 61131-3:2013, table 46 and figure 15 (timing diagrams).

use crate::time::nanoseconds;
use core::time::Duration;

/// On-delay timer: the output follows a rising input after `PT`, and a falling one at once.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ton {
    et: u64,
    running: bool,
    q: bool,
}

impl Ton {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { et: 0, running: false, q: false }
    }

    /// The new output.
    pub fn update(&mut self, input: bool, pt: Duration, elapsed: Duration) -> bool {
        let pt = nanoseconds(pt);
        self.et = match (input, self.running) {
            (true, true) => self.et.saturating_add(nanoseconds(elapsed)).min(pt),
            _ => 0,
        };
        self.running = input;
        self.q = input && self.et >= pt;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }

    /// Time since the input rose, at most `PT`.
    #[must_use]
    pub const fn et(&self) -> Duration {
        Duration::from_nanos(self.et)
    }
}

/// Off-delay timer: the output follows a rising input at once, and a falling one after `PT`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tof {
    et: u64,
    running: bool,
    q: bool,
}

impl Tof {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { et: 0, running: false, q: false }
    }

    /// The new output.
    pub fn update(&mut self, input: bool, pt: Duration, elapsed: Duration) -> bool {
        let pt = nanoseconds(pt);
        if input {
            self.et = 0;
            self.running = false;
            self.q = true;
        } else if self.q {
            if self.running {
                self.et = self.et.saturating_add(nanoseconds(elapsed));
            }
            self.et = self.et.min(pt);
            self.running = true;
            self.q = self.et < pt;
        }
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }

    /// Time since the input fell, at most `PT`; it stays there until the input rises.
    #[must_use]
    pub const fn et(&self) -> Duration {
        Duration::from_nanos(self.et)
    }
}

/// Pulse timer: a rising input gives a pulse of `PT`, however long the input stays.
///
/// A running pulse is not lengthened. A pulse that is over at the call that sees the next edge is
/// followed by the next pulse.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tp {
    et: u64,
    last_input: bool,
    q: bool,
}

impl Tp {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { et: 0, last_input: false, q: false }
    }

    /// The new output.
    pub fn update(&mut self, input: bool, pt: Duration, elapsed: Duration) -> bool {
        let pt = nanoseconds(pt);
        if self.q {
            self.et = self.et.saturating_add(nanoseconds(elapsed)).min(pt);
            self.q = self.et < pt;
        }
        if !self.q {
            if input && !self.last_input {
                self.et = 0;
                self.q = pt > 0;
            } else if !input {
                self.et = 0;
            }
        }
        self.last_input = input;
        self.q
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q(&self) -> bool {
        self.q
    }

    /// Time since the pulse began, at most `PT`; zero when pulse and input are over.
    #[must_use]
    pub const fn et(&self) -> Duration {
        Duration::from_nanos(self.et)
    }
}
