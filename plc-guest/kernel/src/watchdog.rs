//! When a job has used too much time.
//!
//! A task has a *budget*, and a *sensitivity* as the watchdogs of other PLC runtimes have it: with
//! sensitivity *n*, jobs may exceed the budget, but at most *n* one after the other, and no single
//! job may take more than *n* + 1 times the budget. With 0 the budget is the limit of each job.
//!
//! There is no timer in a PLC's windows. A job that exceeds its budget is therefore found at the next
//! entry into the kernel: at a call of its own, at its end, or at the start of the next window. Until
//! then it has had the rest of one window, which is the partition's own.

use crate::time::Span;

/// The watch over the jobs of one task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Watchdog {
    /// Execution time that a job may use.
    budget: Span,
    /// See the [module](self).
    sensitivity: u16,
    /// Execution time that no job may exceed.
    most: Span,
    /// Jobs over their budget, one after the other.
    exceeded: u32,
    /// The end of a job that has executed for no longer changes nothing here.
    quiet: Span,
}

impl Watchdog {
    /// A watchdog that has seen nothing.
    #[must_use]
    pub const fn new(budget: Span, sensitivity: u16) -> Self {
        let budget = if budget.0 == 0 { Span(u64::MAX) } else { budget };
        let most = budget.times(sensitivity as u64 + 1);
        Self { budget, sensitivity, most, exceeded: 0, quiet: budget }
    }

    /// True if a job that has executed for so long must not go on.
    #[must_use]
    pub const fn expired(&self, executed: Span) -> bool {
        executed.0 > self.most.0
    }

    /// True if a job that ended after so long exceeded its budget.
    #[must_use]
    pub const fn exceeds(&self, executed: Span) -> bool {
        executed.0 > self.budget.0
    }

    /// True if the end of a job that has executed for so long changes anything here.
    #[must_use]
    pub const fn is_to_see(&self, executed: Span) -> bool {
        executed.0 > self.quiet.0
    }

    /// The program starts anew: what jobs did before counts no more.
    pub const fn forget(&mut self) {
        self.exceeded = 0;
        self.quiet = self.budget;
    }

    /// A job has ended. True if it was one too many over its budget; the count then starts anew.
    pub fn ended(&mut self, executed: Span) -> bool {
        let exceeds = self.exceeds(executed);
        self.exceeded = if exceeds { self.exceeded + 1 } else { 0 };
        let too_many = exceeds && self.exceeded > self.sensitivity.into();
        if too_many {
            self.exceeded = 0;
        }
        self.quiet = if self.exceeded == 0 { self.budget } else { Span::ZERO };
        too_many
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_of_zero_is_no_limit() {
        let mut none = Watchdog::new(Span::ZERO, 1);
        assert!(!none.expired(Span(u64::MAX)) && !none.ended(Span(u64::MAX)));
    }

    #[test]
    fn sensitivity_zero_limits_each_job() {
        let mut dog = Watchdog::new(Span(100), 0);
        assert!(!dog.expired(Span(100)) && dog.expired(Span(101)));
        assert!(!dog.ended(Span(100)) && dog.ended(Span(101)) && dog.ended(Span(101)));
    }

    #[test]
    fn sensitivity_two_allows_two_in_a_row_and_three_times_the_budget() {
        let mut dog = Watchdog::new(Span(100), 2);
        assert!(!dog.expired(Span(300)) && dog.expired(Span(301)));
        assert_eq!(
            [150, 150, 100, 150, 150, 150].map(|t| dog.ended(Span(t))),
            [false, false, false, false, false, true]
        );
        assert!(!dog.ended(Span(150)), "the count starts anew");
    }

    #[test]
    fn a_limit_beyond_all_time_is_none() {
        let dog = Watchdog::new(Span(u64::MAX / 2), u16::MAX);
        assert!(!dog.expired(Span(u64::MAX)));
    }
}
