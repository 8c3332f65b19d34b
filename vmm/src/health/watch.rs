//! The supervisor thread's side: from notes and ends to lines and a report.
//!
//! A guest decides how many errors it makes, and must not decide how much is printed or kept. So
//! a partition has so many lines a second and so many places in the report, and whatever has none
//! is told as a number.

use std::sync::Arc;

use rtrb::Consumer;
use takt_scheduler::time::{Nanos, Timebase};

use super::detail::Detail;
use super::monitor::Monitor;
use super::reporter::{Counts, Occurrence, Reporter};
use super::{Action, Table};
use super::{FAULTS, Fault};
use crate::life::Finished;
use crate::report;

/// Lines a second about errors that a guest survives.
const LINES: u32 = 5;
/// Places in the report for errors that a guest survives.
const LISTED: usize = 32;
/// Places for all.
const LISTED_WITH_ENDS: usize = 64;

/// Watches over one partition.
pub struct Watch {
    counts: Arc<Counts>,
    notes: Consumer<Occurrence>,
    monitor: Monitor,
    /// Number of the next note, if none is missing.
    next: u64,
    lines: LineLimit,
    list: Vec<report::Event>,
    /// Events so far, those counted that are not listed.
    events: u64,
}

/// What of the lines of one second is used up.
#[derive(Debug, Default)]
struct LineLimit {
    second: u64,
    shown: u32,
    /// Lines that were not shown and not told of yet.
    hidden: u64,
}

impl LineLimit {
    /// Whether another line at this time may be shown. Calls `tell` with the number of those that
    /// were not, when a second is over.
    fn allows(&mut self, at: Nanos, tell: impl FnOnce(u64)) -> bool {
        self.advance(at, tell);
        self.shown += 1;
        let allowed = self.shown <= LINES;
        self.hidden += u64::from(!allowed);
        allowed
    }

    fn advance(&mut self, at: Nanos, tell: impl FnOnce(u64)) {
        let second = at.0 / 1_000_000_000;
        if second > self.second {
            (self.second, self.shown) = (second, 0);
            self.flush(tell);
        }
    }

    fn flush(&mut self, tell: impl FnOnce(u64)) {
        let hidden = std::mem::take(&mut self.hidden);
        if hidden > 0 {
            tell(hidden);
        }
    }
}

fn more(hidden: u64) -> String {
    let s = if hidden == 1 { "" } else { "s" };
    format!("{hidden} more error{s}, not shown")
}

impl Watch {
    /// For a partition with this table, and what its thread reports with.
    #[must_use]
    pub fn new(table: Table) -> (Watch, Reporter) {
        let (reporter, counts, notes) = Reporter::new(table);
        let watch = Watch {
            counts,
            notes,
            monitor: Monitor::new(table),
            next: 0,
            lines: LineLimit::default(),
            list: Vec::new(),
            events: 0,
        };
        (watch, reporter)
    }

    /// Takes the notes that have come until `now`, and calls `show` with each line.
    pub fn take(&mut self, base: Timebase, now: Nanos, mut show: impl FnMut(&str)) {
        // No more than there are now: a guest may go on making them.
        for _ in 0..self.notes.slots() {
            let Ok(Occurrence { sequence, at, detail }) = self.notes.pop() else { break };
            self.miss(sequence);
            self.next = sequence.saturating_add(1);
            let at = base.offset(at);
            let line = self.lines.allows(at, |hidden| show(&more(hidden)));
            let listed = self.list.len() < LISTED;
            self.events += 1;
            if !line && !listed {
                continue;
            }
            let event = self.event(at, detail.fault(), detail.to_string(), Action::Log);
            if line {
                show(&describe(&event, &event.action));
            }
            if listed {
                self.list.push(event);
            }
        }
        self.lines.advance(now, |hidden| show(&more(hidden)));
    }

    /// Counts an error that was found on this side, of a guest that runs, and tells of it if it is to go
    /// on. Returns what the table says: a guest that is not to go on has to be ended.
    pub fn raise(&mut self, detail: Detail, now: Nanos, mut show: impl FnMut(&str)) -> Action {
        let fault = detail.fault();
        self.counts.add(fault, 1);
        let action = self.monitor.action(fault);
        if action == Action::Log {
            self.events += 1;
            let event = self.event(now, fault, detail.to_string(), action);
            show(&describe(&event, &event.action));
            if self.list.len() < LISTED {
                self.list.push(event);
            }
        }
        action
    }

    /// Takes note of how the guest ended, and says what follows; `None` if it is no error.
    pub fn end(
        &mut self,
        finished: &Finished,
        base: Timebase,
        mut show: impl FnMut(&str),
    ) -> Option<Action> {
        let fault = finished.end.fault()?;
        let at = base.offset(finished.at);
        self.take(base, at, &mut show);
        self.miss(finished.noted);
        self.lines.flush(|hidden| show(&more(hidden)));
        let verdict = self.monitor.end(fault, finished.starting, at);
        self.events += 1;
        let event = self.event(at, fault, finished.end.to_string(), verdict.action);
        show(&describe(&event, &verdict.to_string()));
        if self.list.len() < LISTED_WITH_ENDS {
            self.list.push(event);
        }
        Some(verdict.action)
    }

    /// Counts the notes before this one that did not fit into the ring.
    fn miss(&mut self, sequence: u64) {
        let missing = sequence.saturating_sub(self.next);
        self.next = self.next.max(sequence);
        self.events += missing;
        self.lines.hidden += missing;
    }

    /// The event that was counted last.
    fn event(&self, at: Nanos, fault: Fault, detail: String, action: Action) -> report::Event {
        let sequence = self.events;
        let (error, action) = (fault.name(), action.name());
        report::Event { sequence, at_ns: at.0, error: error.into(), detail, action: action.into() }
    }

    /// How often an error happened.
    #[must_use]
    pub fn count(&self, fault: Fault) -> u64 {
        self.counts.of(fault)
    }

    /// What a report tells.
    #[must_use]
    pub fn report(&self) -> report::Events {
        let count = |fault: Fault| (fault.name().into(), self.count(fault));
        report::Events {
            totals: FAULTS.into_iter().map(count).filter(|(_, count)| *count > 0).collect(),
            unlisted: self.events - self.list.len() as u64,
            list: self.list.clone(),
        }
    }
}

fn describe(event: &report::Event, action: &str) -> String {
    format!("{}: {} -> {action}", event.error, event.detail)
}

#[cfg(test)]
mod tests {
    use super::super::detail::{Access, Detail, Target};
    use super::*;
    use crate::vcpu::guest::End;
    use takt_scheduler::time::{Tsc, TscFrequency};

    const BASE: Timebase = match TscFrequency::from_khz(1_000_000) {
        Some(frequency) => Timebase { epoch: Tsc(0), frequency },
        None => panic!(),
    };
    const READ: Detail = Detail::Access(Access {
        target: Target::Port(0x60),
        bytes: 4,
        write: false,
        rip: Some(0x10_0040),
    });

    fn finished(end: End, at: u64, noted: u64) -> Finished {
        Finished { end, at: Tsc(at), starting: false, noted, cpu_time: Nanos::ZERO }
    }

    /// The lines of one look at the notes.
    fn taken(watch: &mut Watch, now: u64) -> Vec<String> {
        let mut lines = Vec::new();
        watch.take(BASE, Nanos(now), |line| lines.push(line.to_owned()));
        lines
    }

    #[test]
    fn events_come_in_order_and_are_told_once() {
        let (mut watch, mut reporter) = Watch::new(Table::PLC);
        reporter.raise(READ, 1);
        reporter.raise(Detail::Overrun(7), 1);
        reporter.end(End::TripleFault);
        let mut lines = Vec::new();
        let end = finished(End::TripleFault, 9, reporter.noted());
        let action = watch.end(&end, BASE, |line| lines.push(line.to_owned()));
        assert_eq!(action, Some(Action::Idle));
        assert_eq!(
            lines,
            [
                "illegal-request: read of 4 bytes at port 0x60, rip 0x100040 -> log",
                "deadline-missed: the window of release 7 ended before the guest was done -> log",
                "processor-shutdown: triple fault -> idle",
            ]
        );
        assert!(taken(&mut watch, u64::MAX).is_empty());
        let report = watch.report();
        let numbers: Vec<u64> = report.list.iter().map(|event| event.sequence).collect();
        assert_eq!((numbers, report.unlisted), (vec![1, 2, 3], 0));
        assert_eq!(report.list[2].at_ns, 9);
        let totals: Vec<_> = report.totals.into_iter().collect();
        let names = ["deadline-missed", "illegal-request", "processor-shutdown"];
        assert_eq!(totals, names.map(|name| (name.into(), 1)));
    }

    #[test]
    fn a_flood_has_few_lines_and_no_error_is_lost_from_the_figures() {
        let (mut watch, mut reporter) = Watch::new(Table::PLC);
        let flood = 5_000;
        for _ in 0..flood {
            reporter.raise(READ, 1);
        }
        let first = taken(&mut watch, 0);
        assert!((1..=2 * LINES as usize + 1).contains(&first.len()), "{first:?}");
        let mut lines = Vec::new();
        let end = finished(End::Exited(0), u64::MAX >> 1, reporter.noted());
        watch.end(&end, BASE, |line| lines.push(line.to_owned()));
        assert!(lines[0].ends_with("more errors, not shown"), "{lines:?}");
        assert_eq!(lines.last().unwrap(), "partition-ended: ended itself with code 0 -> idle");

        let shown = first.iter().chain(&lines).filter(|line| line.ends_with("-> log")).count();
        let hidden = first
            .iter()
            .chain(&lines)
            .filter_map(|line| line.strip_suffix(" more errors, not shown"));
        let hidden: usize = hidden.map(|n| n.parse::<usize>().unwrap()).sum();
        assert_eq!(shown + hidden, flood);
        let report = watch.report();
        assert_eq!(report.totals["illegal-request"], flood as u64);
        assert_eq!(report.list.len() as u64 + report.unlisted, flood as u64 + 1);
        assert_eq!(report.list.len(), LISTED + 1);
        assert_eq!(report.list[LISTED].sequence, flood as u64 + 1);
    }

    #[test]
    fn what_was_hidden_is_told_when_its_second_is_over() {
        let mut limit = LineLimit::default();
        let mut told = Vec::new();
        for _ in 0..LINES + 2 {
            limit.allows(Nanos(5), |n| told.push(n));
        }
        assert!(told.is_empty());
        limit.advance(Nanos(1_000_000_000), |n| told.push(n));
        assert!(limit.allows(Nanos(1_000_000_001), |n| told.push(n)));
        assert_eq!(told, [2]);
    }

    #[test]
    fn an_error_of_the_hosts_is_counted_once_whatever_follows() {
        use super::super::ACTIONS;
        use super::super::detail::ClockFault;
        let detail = Detail::Clock(ClockFault::Rate { clock_ahead_ns: -40_000_000 });
        for action in ACTIONS {
            let (mut watch, mut reporter) = Watch::new(Table::PLC.with(Fault::ClockFault, action));
            let mut lines = Vec::new();
            let told = watch.raise(detail, Nanos(5), |line| lines.push(line.to_owned()));
            assert_eq!((told, lines.len()), (action, usize::from(action == Action::Log)));
            if !action.goes_on() {
                let end = End::Raised(detail);
                reporter.end(end);
                watch.end(&finished(end, 9, 0), BASE, |line| lines.push(line.to_owned()));
            }
            assert_eq!(watch.count(Fault::ClockFault), 1, "{action}");
            let events = usize::from(action != Action::Ignore);
            assert_eq!((watch.report().list.len(), lines.len()), (events, events), "{action}");
        }
    }

    #[test]
    fn what_takt_ends_is_no_event() {
        let (mut watch, _reporter) = Watch::new(Table::PLC);
        let verdict = watch.end(&finished(End::Stopped, 0, 0), BASE, |_| panic!());
        assert_eq!((verdict, watch.report().list.len()), (None, 0));
    }
}
