//! How many lines a program may log.
//!
//! A line costs an exit in the partition's window, so a program that logs in each job would take time from
//! its neighbours. Each program has some lines in stock, and gets one more in each step of time.

use takt_kernel::time::{Instant, Span};
use takt_program::limit;

/// Lines at once.
const STOCK: u32 = limit::LOG_LINES;
/// One more after this time.
const STEP: Span = Span(limit::LOG_STEP_NS);

/// The lines that a program may log.
#[derive(Clone, Copy, Debug)]
pub struct Allowance {
    lines: u32,
    filled: Instant,
    dropped: u64,
}

impl Allowance {
    /// At the start.
    pub const FULL: Self = Self { lines: STOCK, filled: Instant(0), dropped: 0 };

    /// Takes a line, if there is one: how many were dropped before it.
    pub fn take(&mut self, now: Instant) -> Option<u64> {
        let more = now.since(self.filled).0 / STEP.0;
        if more > 0 {
            self.filled = self.filled.after(STEP.times(more));
            self.lines = self.lines.saturating_add(more.min(STOCK.into()) as u32).min(STOCK);
        }
        match self.lines.checked_sub(1) {
            Some(rest) => {
                self.lines = rest;
                Some(core::mem::take(&mut self.dropped))
            }
            None => {
                self.drop_line();
                None
            }
        }
    }

    /// Counts a line that is not printed.
    pub fn drop_line(&mut self) {
        self.dropped = self.dropped.saturating_add(1);
    }

    /// Takes back a line that was not printed, and so many before it whose loss was not told.
    pub fn give_back(&mut self, dropped: u64) {
        self.lines = self.lines.saturating_add(1);
        self.dropped = self.dropped.saturating_add(dropped);
    }
}
