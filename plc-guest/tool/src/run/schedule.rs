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

    /// Runs all jobs that are released in the next `step` nanoseconds: by release time, then by priority. A task
    /// that waits for an edge is released by a value that has become true since the last step, one that waits for
    /// messages by each that was there at its begin; freewheeling tasks run once, last.
    pub fn step(&mut self, machine: &mut Machine<'_>, step: u64) -> Result<Vec<Logged>, Failed> {
        let mut logged = Vec::new();
        let end = self.now.saturating_add(step);
        for scheduled in &mut self.tasks {
            scheduled.look(machine);
        }
        let mut due: Vec<(u64, u8, usize)> = Vec::new();
        for (index, scheduled) in self.tasks.iter_mut().enumerate() {
            let priority = scheduled.task.priority;
            match scheduled.task.kind {
                TaskKind::Cyclic { period, .. } => {
                    while scheduled.next < end {
                        due.push((scheduled.next, priority, index));
                        scheduled.next = scheduled.next.saturating_add(period.0);
                    }
                }
                TaskKind::Event { source: EventSource::Channel(port), minimum } => {
                    // One job for each message; what a job reads more of them, others find gone.
                    let first = scheduled.next.max(self.now);
                    let releases = (0..machine.waiting(port) as u64)
                        .map(|job| first.saturating_add(job.saturating_mul(minimum.0)));
                    let releases = releases.take_while(|release| *release < end);
                    due.extend(releases.map(|release| (release, priority, index)));
                }
                TaskKind::Event { minimum, .. } => {
                    if scheduled.pending && scheduled.next < end {
                        scheduled.pending = false;
                        let release = scheduled.next.max(self.now);
                        due.push((release, priority, index));
                        scheduled.next = release.saturating_add(minimum.0);
                    }
                }
                TaskKind::Freewheeling => due.push((end - 1, u8::MAX, index)),
            }
        }
        due.sort_unstable();
        for (now, _, index) in due {
            let scheduled = &mut self.tasks[index];
            if let TaskKind::Event { source: EventSource::Channel(port), minimum } =
                scheduled.task.kind
            {
                if machine.waiting(port) == 0 {
                    continue;
                }
                scheduled.next = now.saturating_add(minimum.0);
            }
            logged.extend(self.run(machine, index, now)?);
        }
        self.now = end;
        Ok(logged)
    }

    fn run(
        &mut self,
        machine: &mut Machine<'_>,
        index: usize,
        now: u64,
    ) -> Result<Vec<Logged>, Failed> {
        let scheduled = &mut self.tasks[index];
        let period = scheduled.last.map_or(0, |last| now - last);
        let (task, cycle) = (scheduled.task, scheduled.cycle);
        (scheduled.last, scheduled.cycle) = (Some(now), cycle + 1);
        let lines = machine.job(&Job { task, cycle, now, period })?;
        let logged = |line| Logged { task: task.name.to_owned(), now, line };
        Ok(lines.into_iter().map(logged).collect())
    }
}

impl Scheduled<'_> {
    /// Notes whether the variable that it waits for has become true.
    fn look(&mut self, machine: &Machine<'_>) {
        let Some((place, was)) = &mut self.edge else { return };
        let is = place.get(machine).is_some_and(|value| value.is_true());
        let before = std::mem::replace(was, is);
        self.pending |= is && !before;
    }
}
