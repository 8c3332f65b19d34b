//! Which task runs when, in simulated time.

use takt_program::{EventSource, Image, Task, TaskKind};

use super::fault::Failed;
use super::machine::{Job, Machine};
use crate::value::Place;

/// The tasks of a program, each with its next release.
pub struct Schedule<'a> {
    tasks: Vec<Scheduled<'a>>,
    now: u64,
}

struct Scheduled<'a> {
    task: Task<'a>,
    cycle: u64,
    last: Option<u64>,
    /// The next release of a cyclic task; the earliest of an event task.
    next: u64,
    /// The variable that releases an event task, and what it was.
    edge: Option<(Place, bool)>,
    /// An event has come and not been served: its least time was not over.
    pending: bool,
}

/// A line that a task logged.
pub struct Logged {
    pub task: String,
    pub now: u64,
    pub line: String,
}

impl<'a> Schedule<'a> {
    /// All tasks, before their first releases.
    pub fn new(image: &Image<'a>) -> Self {
        let edge = |task: &Task<'_>| match task.kind {
            TaskKind::Event { source: EventSource::Rise(name), .. } => {
                Place::find(image, name).ok().map(|place| (place, false))
            }
            _ => None,
        };
        let first = |task: &Task<'_>| match task.kind {
            TaskKind::Cyclic { offset, .. } => offset.0,
            TaskKind::Event { .. } | TaskKind::Freewheeling => 0,
        };
        let scheduled = |task: Task<'a>| Scheduled {
            cycle: 0,
            last: None,
            next: first(&task),
            edge: edge(&task),
            pending: false,
            task,
        };
        Self { tasks: image.tasks().map(scheduled).collect(), now: 0 }
    }

    /// All tasks of a program that runs for this long: releases before then are over, and what the variables of event
    /// tasks are now is no edge.
    pub fn at(image: &Image<'a>, now: u64, machine: &Machine<'_>) -> Self {
        let mut schedule = Self { now, ..Self::new(image) };
        for scheduled in &mut schedule.tasks {
            scheduled.look(machine);
            scheduled.pending = false;
            if let TaskKind::Cyclic { period, .. } = scheduled.task.kind {
                let period = period.0.max(1);
                let over = now.saturating_sub(scheduled.next).div_ceil(period);
                scheduled.next = scheduled.next.saturating_add(over.saturating_mul(period));
                scheduled.cycle = over;
                scheduled.last = (over > 0).then(|| scheduled.next.saturating_sub(period));
            }
        }
        schedule
    }

    /// Without a task, which is released by other means.
    pub fn without(mut self, name: &str) -> Self {
        self.tasks.retain(|scheduled| scheduled.task.name != name);
        self
    }

    /// Lets time pass in which nothing is released.
    pub fn skip(&mut self, nanoseconds: u64) {
        self.now = self.now.saturating_add(nanoseconds);
        for scheduled in &mut self.tasks {
            let TaskKind::Cyclic { period, .. } = scheduled.task.kind else { continue };
            let missed = self.now.saturating_sub(scheduled.next).div_ceil(period.0.max(1));
            scheduled.next = scheduled.next.saturating_add(missed.saturating_mul(period.0));
        }
    }

    /// The shortest period of the cyclic tasks, in nanoseconds: one row of a table.
    pub fn shortest_period(&self) -> Option<u64> {
        let period = |task: &Scheduled<'_>| match task.task.kind {
            TaskKind::Cyclic { period, .. } => Some(period.0),
            TaskKind::Event { .. } | TaskKind::Freewheeling => None,
        };
        self.tasks.iter().filter_map(period).min()
    }

    /// Simulated time, in nanoseconds.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Runs all jobs that are released in the next `step` nanoseconds: by release time, then by priority. As in the
    /// guest, events are looked for at the begin and behind each job. Freewheeling tasks run once, last. What the jobs
    /// log is added, also by one that ends in a fault.
    pub fn step(
        &mut self,
        machine: &mut Machine<'_>,
        step: u64,
        logged: &mut Vec<Logged>,
    ) -> Result<(), Failed> {
        let end = self.now.saturating_add(step);
        self.look(machine);
        while let Some((release, index)) = self.first(machine).filter(|(first, _)| *first < end) {
            self.now = release;
            self.tasks[index].released(release);
            self.run(machine, index, release, logged)?;
            self.look(machine);
        }
        // Nothing of a step that takes no time is left to them.
        for index in 0..self.tasks.len() {
            if self.now < end && self.tasks[index].task.kind == TaskKind::Freewheeling {
                self.run(machine, index, end - 1, logged)?;
            }
        }
        self.now = end;
        Ok(())
    }

    /// Runs what is released in this time, in pieces of the shortest period (of 1 ms if there is none), of which the last may
    /// be shorter. Freewheeling tasks have a job in each piece, as they have in each window of the guest.
    pub fn pass(
        &mut self,
        machine: &mut Machine<'_>,
        time: u64,
        logged: &mut Vec<Logged>,
    ) -> Result<(), Failed> {
        const WINDOW: u64 = 1_000_000;
        let window = self.shortest_period().unwrap_or(WINDOW);
        let end = self.now.saturating_add(time);
        while self.now < end {
            self.step(machine, window.min(end - self.now), logged)?;
        }
        Ok(())
    }

    fn look(&mut self, machine: &Machine<'_>) {
        self.tasks.iter_mut().for_each(|scheduled| scheduled.look(machine));
    }

    /// The next release that is known now, and of which task.
    fn first(&self, machine: &Machine<'_>) -> Option<(u64, usize)> {
        let release = |(index, scheduled): (usize, &Scheduled<'_>)| {
            let release = scheduled.release(self.now, machine)?;
            Some((release, scheduled.task.priority, index))
        };
        let first = self.tasks.iter().enumerate().filter_map(release).min()?;
        Some((first.0, first.2))
    }

    fn run(
        &mut self,
        machine: &mut Machine<'_>,
        index: usize,
        now: u64,
        logged: &mut Vec<Logged>,
    ) -> Result<(), Failed> {
        let scheduled = &mut self.tasks[index];
        let period = scheduled.last.map_or(0, |last| now - last);
        let (task, cycle) = (scheduled.task, scheduled.cycle);
        (scheduled.last, scheduled.cycle) = (Some(now), cycle + 1);
        let ran = machine.job(&Job { task, cycle, now, period });
        machine.take_log(task.name, now, logged);
        ran
    }
}

impl Scheduled<'_> {
    /// When it is released next, as far as that is known now.
    fn release(&self, now: u64, machine: &Machine<'_>) -> Option<u64> {
        let happened = match self.task.kind {
            TaskKind::Cyclic { .. } => return Some(self.next),
            // What a job reads more than one message, others find gone.
            TaskKind::Event { source: EventSource::Channel(port), .. } => machine.waiting(port) > 0,
            TaskKind::Event { .. } => self.pending,
            TaskKind::Freewheeling => false,
        };
        happened.then(|| self.next.max(now))
    }

    /// It is released at this time.
    fn released(&mut self, now: u64) {
        self.pending = false;
        match self.task.kind {
            TaskKind::Cyclic { period: time, .. } | TaskKind::Event { minimum: time, .. } => {
                self.next = now.saturating_add(time.0);
            }
            TaskKind::Freewheeling => {}
        }
    }

    /// Notes whether the variable that it waits for has become true.
    fn look(&mut self, machine: &Machine<'_>) {
        let Some((place, was)) = &mut self.edge else { return };
        let is = place.get(machine).is_some_and(|value| value.is_true());
        let before = std::mem::replace(was, is);
        self.pending |= is && !before;
    }
}
