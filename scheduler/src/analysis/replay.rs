//! The exact answer: one hyperperiod of the schedule, replayed.
//!
//! Nothing happens between two events, so the replay jumps: to the end of the most urgent job,
//! which the supply gives in closed form across any number of windows, or to the next release,
//! whichever comes first. Its cost is in the number of jobs, not in time or windows.
//!
//! If every job is complete by the end of the hyperperiod, the state is that of the epoch again,
//! and the replay stands for all time.
//!
//! The supply has the interrupts of a window at its start. For a job whose most urgent work began outside of windows that is the
//! worst case. Work that begins inside of a window may meet all of that window's interrupts after that, so the replay has
//! them once more at each release inside of a window. That is safe for each task, since its busy intervals begin with releases,
//! but it may be too much: then the answer is no longer exact.

use super::{Method, Miss, Supply, TaskSet, Verdict};
use crate::time::Nanos;

/// Most jobs in a hyperperiod for which it is replayed: a fraction of a second of work.
pub const JOBS_MAX: u64 = 200_000;

/// Replays the schedule up to the first deadline that is missed, else for one hyperperiod, and says whether that is exact or on
/// the safe side. `None` if there are more than [`JOBS_MAX`] jobs in it.
#[must_use]
pub fn replay(tasks: &TaskSet, supply: &Supply) -> Option<(Method, Verdict)> {
    let hyperperiod = tasks.hyperperiod(supply.frame())?;
    let jobs: u64 = tasks.tasks().iter().map(|task| hyperperiod.0 / task.period.0).sum();
    (jobs <= JOBS_MAX).then(|| Replay::at_epoch(tasks).run(supply, hyperperiod))
}

/// A task in the replay.
struct Level {
    /// Position in the set.
    task: usize,
    period: Nanos,
    budget: Nanos,
    /// Release of the current job.
    release: Nanos,
    /// What the current job still has to execute.
    left: Nanos,
    /// Worst response so far.
    response: Nanos,
}

impl Level {
    fn next_release(&self) -> Nanos {
        self.release.plus(self.period)
    }
}

struct Replay {
    now: Nanos,
    /// Until when interrupts keep all tasks from running.
    held_up: Nanos,
    /// Exact until there was such an interrupt.
    method: Method,
    /// The most urgent first.
    levels: Box<[Level]>,
}

impl Replay {
    /// The first job of each task has just been released.
    fn at_epoch(tasks: &TaskSet) -> Replay {
        let levels = tasks.by_urgency().map(|(task, t)| Level {
            task,
            period: t.period,
            budget: t.budget,
            release: Nanos::ZERO,
            left: t.budget,
            response: Nanos::ZERO,
        });
        let now = Nanos::ZERO;
        Replay { now, held_up: now, method: Method::Exact, levels: levels.collect() }
    }

    fn run(mut self, supply: &Supply, hyperperiod: Nanos) -> (Method, Verdict) {
        while self.now < hyperperiod {
            let next = self.levels.iter().map(Level::next_release).min().unwrap_or(hyperperiod);
            self.execute(supply, next);
            if let Some(miss) = self.release() {
                return (self.method, Verdict::Misses(miss));
            }
            if let Some(held_up) = supply.held_up(self.now) {
                (self.held_up, self.method) = (held_up, Method::Bound);
            }
        }
        let mut responses = vec![Nanos::ZERO; self.levels.len()];
        for level in &self.levels {
            responses[level.task] = level.response;
        }
        (self.method, Verdict::Meets { responses: responses.into() })
    }

    /// Runs what is pending until `until`, before which nothing is released.
    fn execute(&mut self, supply: &Supply, until: Nanos) {
        self.now = self.now.max(self.held_up).min(until);
        while let Some(job) = self.levels.iter_mut().find(|level| level.left > Nanos::ZERO) {
            match supply.finish(self.now, job.left).filter(|finish| *finish <= until) {
                Some(finish) => {
                    job.left = Nanos::ZERO;
                    job.response = job.response.max(finish.less(job.release));
                    self.now = finish;
                }
                None => {
                    job.left = job.left.less(supply.available(self.now, until));
                    break;
                }
            }
        }
        self.now = until;
    }

    /// Releases the jobs that are due now; each is the deadline of the one before it.
    fn release(&mut self) -> Option<Miss> {
        let now = self.now;
        for level in self.levels.iter_mut().filter(|level| level.next_release() == now) {
            if level.left > Nanos::ZERO {
                return Some(Miss {
                    task: level.task,
                    release: level.release,
                    deadline: now,
                    undone: level.left,
                });
            }
            level.release = now;
            level.left = level.budget;
        }
        None
    }
}
