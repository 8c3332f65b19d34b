//! What is counted for each task.
//!
//! These are the figures that an engineer compares with the analysis of `takt check`: longest
//! execution, longest response, least slack. Spans are nanoseconds, and all counters stop at their
//! largest value instead of starting again.

use crate::time::Span;

/// Figures of one task since its program was started first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Statistics {
    /// Jobs that have come to their end.
    pub jobs: u64,
    /// Jobs that were not complete at their deadline.
    pub misses: u64,
    /// Releases that were lost because the job before was not complete, or because no window came; of an event task,
    /// events that came while one was waiting already.
    pub overruns: u64,
    /// Jobs that used more than their budget.
    pub over_budget: u64,
    /// Jobs that were ended by the kernel.
    pub skipped: u64,
    /// Shortest execution of a job.
    pub executed_min: Span,
    /// Longest execution of a job.
    pub executed_max: Span,
    /// Execution of all jobs together that precede the current one.
    pub(crate) executed: Span,
    /// Longest time from a release to the end of its job.
    pub response_max: Span,
    /// Longest time from a release to the start of its job.
    pub start_max: Span,
    /// Shortest time from the end of a job to its deadline; 0 if it was missed.
    pub slack_min: Span,
    /// Times that the processor was given to the task.
    pub switches: u64,
}

impl Statistics {
    /// Nothing has happened.
    pub const NONE: Self = Self {
        jobs: 0,
        misses: 0,
        overruns: 0,
        over_budget: 0,
        skipped: 0,
        executed_min: Span(u64::MAX),
        executed_max: Span::ZERO,
        executed: Span::ZERO,
        response_max: Span::ZERO,
        start_max: Span::ZERO,
        slack_min: Span(u64::MAX),
        switches: 0,
    };

    /// A job has ended after so much execution, this long after its release.
    #[inline]
    pub(crate) fn ended(&mut self, executed: Span, response: Span) {
        self.jobs += 1;
        self.executed_min = self.executed_min.min(executed);
        self.executed_max = self.executed_max.max(executed);
        self.response_max = self.response_max.max(response);
    }

    /// A smallest span, if it has been measured.
    #[must_use]
    pub fn measured(span: Span) -> Option<Span> {
        (span.0 != u64::MAX).then_some(span)
    }
}

/// Adds to a counter that stays at its largest value.
pub(crate) fn count(counter: &mut u64, more: u64) {
    *counter = counter.saturating_add(more);
}
