//! The figures of all tasks, as a table on the console.
//!
//! It is printed once a second, a row in each window that has time left for it, so that no release and no
//! task ever waits for it.

use super::kernel::Kernel;
use core::fmt::{self, Write};
use takt_kernel::statistics::Statistics;
use takt_kernel::task::{State, TaskId};
use takt_kernel::time::{Instant, Span};
use takt_plc_guest::console::print;

/// From one table to the next.
const INTERVAL: Span = Span(1_000_000_000);
/// Longest name that has room in the table.
const NAME: usize = 24;

/// What of the table is printed next.
#[derive(Clone, Copy, Debug)]
pub struct Figures {
    /// The next row: 0 is the head, behind it are the tasks.
    row: u8,
    /// When the next table begins.
    next: Instant,
}

impl Figures {
    /// The first table comes after an interval.
    pub const START: Self = Self { row: 0, next: Instant(INTERVAL.0) };
}

impl Kernel {
    /// Prints the next row, if one is due.
    pub fn tell_figures(&mut self) {
        let now = self.now();
        if now < self.figures.next {
            return;
        }
        self.print_row(self.figures.row, now);
        self.figures.row += 1;
        if usize::from(self.figures.row) >= self.rows() {
            let intervals = now.0 / INTERVAL.0 + 1;
            self.figures = Figures { row: 0, next: Instant(0).after(INTERVAL.times(intervals)) };
        }
    }

    /// Prints the whole table: the guest is about to end.
    pub fn print_figures(&mut self) {
        let now = self.now();
        for row in 0..self.rows() as u8 {
            self.print_row(row, now);
        }
    }

    /// The head, the tasks, the CAN controllers, the losses of a port, and the rest.
    fn rows(&self) -> usize {
        self.scheduler.ids().count() + self.io.controllers() + 3
    }

    fn print_row(&mut self, row: u8, now: Instant) {
        match row.checked_sub(1) {
            None => print(format_args!(
                "{:NAME$} {:>8} {:>6} {:>7} {:>7} {:>8} {:>8} {:>8} {:>6} {:>8} {:>6} {:>8} {:>5}",
                "task, ns",
                "jobs",
                "missed",
                "overrun",
                "skipped",
                "exec-min",
                "exec-max",
                "response",
                "start",
                "slack",
                "stack",
                "switches",
                "share"
            )),
            Some(id) if usize::from(id) < self.scheduler.ids().count() => {
                self.print_task(TaskId(id), now);
            }
            Some(row) => {
                let number = usize::from(row) - self.scheduler.ids().count();
                match number.checked_sub(self.io.controllers()) {
                    None => self.io.print_controller(number),
                    Some(0) => self.ports.print_losses(),
                    Some(_) => self.print_rest(now),
                }
            }
        }
    }

    /// What no task has had of the time, with the time outside of windows, and how often the processor
    /// changed hands.
    fn print_rest(&self, now: Instant) {
        let all = self.scheduler.ids().map(|id| self.scheduler.task(id).executed().0);
        let rest = now.0.saturating_sub(all.sum());
        let per_mille = per_mille(rest, now);
        print(format_args!(
            "idle {}.{} %, {} switches",
            per_mille / 10,
            per_mille % 10,
            self.scheduler.switches()
        ));
    }

    fn print_task(&mut self, id: TaskId, now: Instant) {
        let place = self.places[id.index()];
        let Some(program) = &mut self.programs[usize::from(place.program)] else { return };
        let stack = place.number.map_or(0, |number| program.look_at_stack(number));
        let task = self.scheduler.task(id);
        let figures = task.statistics();
        let mut name = Name { text: [0; NAME], length: 0 };
        // A name that is too long is cut.
        let _ = write!(name, "{}.{}", program.name(), program.task_name(place.number));
        let state = match task.state() {
            State::Faulted => " faulted",
            State::Dormant if place.number.is_some() => " stopped",
            _ => "",
        };
        let per_mille = per_mille(task.executed().0, now);
        print(format_args!(
            "{:NAME$} {:>8} {:>6} {:>7} {:>7} {:>8} {:>8} {:>8} {:>6} {:>8} {:>6} {:>8} {:>3}.{}{state}",
            name.text(),
            figures.jobs,
            figures.misses,
            figures.overruns,
            figures.skipped,
            Smallest(figures.executed_min),
            figures.executed_max.0,
            figures.response_max.0,
            figures.start_max.0,
            Smallest(figures.slack_min),
            stack,
            figures.switches,
            per_mille / 10,
            per_mille % 10,
        ));
    }
}

/// A share of all time, for as many years as the clock counts.
fn per_mille(span: u64, now: Instant) -> u64 {
    span / (now.0 / 1000).max(1)
}

/// A smallest span, or `-` where none has been measured.
struct Smallest(Span);

impl fmt::Display for Smallest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Statistics::measured(self.0) {
            Some(span) => fmt::Display::fmt(&span.0, f),
            None => f.pad("-"),
        }
    }
}

/// Program and task.
struct Name {
    text: [u8; NAME],
    length: usize,
}

impl Name {
    fn text(&self) -> &str {
        core::str::from_utf8(&self.text[..self.length]).unwrap_or("?")
    }
}

impl Write for Name {
    fn write_str(&mut self, more: &str) -> fmt::Result {
        for byte in more.bytes() {
            let slot = self.text.get_mut(self.length).ok_or(fmt::Error)?;
            *slot = byte;
            self.length += 1;
        }
        Ok(())
    }
}
