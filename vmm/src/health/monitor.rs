//! The decision: what follows from the end of a guest.
//!
//! A function of the table and of what has been started again before; time is an argument. An
//! action can come out milder than the table has it, never harsher:
//!
//! | state | table | what follows |
//! | --- | --- | --- |
//! | guest runs on | any | the table, by [`Reporter`](super::Reporter) |
//! | ended | `ignore`, `log` | `idle`: there is nothing that could go on |
//! | ended before its first scan | a start | `idle`: it would end there again |
//! | ended, started too often of late | a start | `idle` |
//! | ended otherwise | any other | the table |

use std::collections::VecDeque;
use std::fmt;

use takt_scheduler::time::Nanos;

use super::Fault;
use super::{Action, Limit, Table};

/// Decides for one partition.
#[derive(Debug)]
pub struct Monitor {
    table: Table,
    /// When it was started again, for an error; at most as many as the limit allows.
    starts: VecDeque<Nanos>,
}

/// What follows from an end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// What is to be done.
    pub action: Action,
    /// Why it is not what the table says.
    pub reason: Option<Reason>,
}

/// Why the table's action was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// A guest that has ended cannot go on.
    Ended,
    /// The error came before the guest's first scan.
    Starting,
    /// The partition was started again too often.
    TooOften(Limit),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Reason::Ended => f.write_str("it cannot go on"),
            Reason::Starting => f.write_str("it was still starting"),
            Reason::TooOften(Limit { at_most, within }) => {
                let s = if *at_most == 1 { "" } else { "s" };
                write!(f, "started again {at_most} time{s} within {within}")
            }
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.reason {
            Some(reason) => write!(f, "{}: {reason}", self.action),
            None => self.action.fmt(f),
        }
    }
}

impl Monitor {
    /// A monitor that goes by this table.
    #[must_use]
    pub fn new(table: Table) -> Monitor {
        Monitor { table, starts: VecDeque::with_capacity(table.limit().at_most as usize) }
    }

    /// What the table says of an error.
    #[must_use]
    pub fn action(&self, fault: Fault) -> Action {
        self.table.action(fault)
    }

    /// What follows from the end of the guest by `fault` at `now`, an instant that is never before
    /// that of an earlier call. `starting` says that the guest had not scanned since its start.
    pub fn end(&mut self, fault: Fault, starting: bool, now: Nanos) -> Verdict {
        let action = self.table.action(fault);
        let reason = match action {
            Action::Idle | Action::ShutDown => None,
            Action::Ignore | Action::Log => Some(Reason::Ended),
            Action::ColdStart | Action::WarmStart if starting => Some(Reason::Starting),
            Action::ColdStart | Action::WarmStart => self.start(now),
        };
        Verdict { action: if reason.is_some() { Action::Idle } else { action }, reason }
    }

    /// Notes a start, unless there were too many.
    fn start(&mut self, now: Nanos) -> Option<Reason> {
        let Limit { at_most, within } = self.table.limit();
        while self.starts.front().is_some_and(|start| now.less(*start) >= within) {
            self.starts.pop_front();
        }
        if self.starts.len() >= at_most as usize {
            return Some(Reason::TooOften(self.table.limit()));
        }
        self.starts.push_back(now);
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::ACTIONS;
    use super::super::FAULTS;
    use super::*;

    const LIMIT: Limit = Limit { at_most: 2, within: Nanos::from_millis(100) };

    fn monitor(fault: Fault, action: Action) -> Monitor {
        Monitor::new(Table::PLC.within(LIMIT).with(fault, action))
    }

    #[test]
    fn every_error_with_every_action() {
        for fault in FAULTS {
            for action in ACTIONS {
                let verdict = |starting| monitor(fault, action).end(fault, starting, Nanos::ZERO);
                let idle = |reason| Verdict { action: Action::Idle, reason: Some(reason) };
                let as_the_table = Verdict { action, reason: None };
                let (running, starting) = match action {
                    Action::Ignore | Action::Log => (idle(Reason::Ended), idle(Reason::Ended)),
                    Action::ColdStart | Action::WarmStart => (as_the_table, idle(Reason::Starting)),
                    Action::Idle | Action::ShutDown => (as_the_table, as_the_table),
                };
                assert_eq!(verdict(false), running, "{fault} {action}");
                assert_eq!(verdict(true), starting, "{fault} {action} while starting");
            }
        }
    }

    #[test]
    fn a_partition_that_comes_back_too_often_stays_down() {
        let fault = Fault::NumericError;
        let mut monitor = monitor(fault, Action::WarmStart);
        let mut at = |ms| monitor.end(fault, false, Nanos::from_millis(ms)).action;
        let (start, idle) = (Action::WarmStart, Action::Idle);
        assert_eq!([at(0), at(99), at(99)], [start, start, idle]);
        // The first one is as old as the span: it counts no more; the one that was refused never did.
        assert_eq!([at(100), at(198), at(199), at(200)], [start, idle, start, start]);
    }

    #[test]
    fn the_limit_is_of_all_errors_together_and_can_be_none_at_all() {
        let table = Table::PLC
            .within(LIMIT)
            .with(Fault::NumericError, Action::WarmStart)
            .with(Fault::MemoryViolation, Action::ColdStart);
        let mut monitor = Monitor::new(table);
        let mut end = |fault| monitor.end(fault, false, Nanos::ZERO);
        assert_eq!(end(Fault::NumericError).action, Action::WarmStart);
        assert_eq!(end(Fault::MemoryViolation).action, Action::ColdStart);
        let last = end(Fault::NumericError);
        assert_eq!(last.reason, Some(Reason::TooOften(LIMIT)));
        assert_eq!(last.to_string(), "idle: started again 2 times within 100ms");

        let never = table.within(Limit { at_most: 0, ..LIMIT });
        let mut monitor = Monitor::new(never);
        assert_eq!(monitor.end(Fault::NumericError, false, Nanos::ZERO).action, Action::Idle);
    }
}
