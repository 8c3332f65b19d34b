//! Do the tasks of a partition meet their deadlines inside its windows?
//!
//! A window schedule promises a partition *when* it runs. Whether that is enough for what it has
//! to do is a second question, and one that tests cannot answer: the instant at which all tasks
//! are released just as a window closes may come once an hour. It is answered here, before
//! anything runs, from the partition file alone.
//!
//! The model: periodic tasks with fixed priorities and preemption, each job due when the next one
//! is released, all released together at the epoch, and running only while the partition's windows
//! are open. `docs/analysis.md` says what that leaves out.
//!
//! # Two methods
//!
//! The pattern of releases and windows repeats after the *hyperperiod*, the least common multiple
//! of all periods and the frame. [`replay()`] walks through one hyperperiod from event to event:
//! the exact answer, and its "no" comes with the job that fails. Periods that share no factors
//! make the hyperperiod astronomical; then [`bound()`] compares what may be demanded with what the
//! windows give at the least, whatever the phase. Its "yes" holds, its "no" may be too cautious.
//!
//! # Why a shorter execution never breaks the verdict
//!
//! The replay lets every job use its whole budget, real jobs use less, and with many schedulers an
//! early end can make another job late. Not here. Take a job *J*, and as its *rivals* the jobs of
//! more urgent tasks and the earlier jobs of its own. Preemption makes less urgent jobs invisible
//! to them: whenever the window is open and one of these is pending, one of them runs. So *J* is
//! complete at the first instant after its release at which the pending work of *J* and of the
//! rivals released before that instant is zero. The pending work at an instant *t* is the largest,
//! over all earlier *s*, of the work released in *s..t* less the supply in *s..t*. The supply is a
//! function of time alone and the release instants are fixed, so with smaller executions the
//! pending work is nowhere larger and *J* is complete no later.
//!
//! Both conditions are duties of others. The guest may give a window back ("done") only if no
//! release lies in the rest of it, else the supply would depend on executions. And *later*
//! releases are not covered by the replay, whose tasks keep to the epoch; they are by the bound.

mod bound;
mod replay;
mod supply;
mod task;

pub use bound::{Rule, bound, bound_with};
pub use replay::{JOBS_MAX, replay};
pub use supply::{Start, Supply, SupplyError};
pub use task::{FrameError, PERIOD_MAX, PERIOD_MIN, TASKS_MAX, Task, TaskSet, TaskSetError};

use crate::time::Nanos;

/// How a verdict was reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By [`replay()`]: response times are reached, and a miss is real.
    Exact,
    /// By [`bound()`], or by [`replay()`] with releases inside of windows: response times are upper bounds, and a refusal may
    /// be too cautious.
    Bound,
}

/// A job that is not complete when its successor is released, every job using its whole budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Miss {
    /// The task, by its position in the set.
    pub task: usize,
    /// Release of the job, since the epoch.
    pub release: Nanos,
    /// Its deadline, since the epoch.
    pub deadline: Nanos,
    /// Execution that it still lacks at its deadline; never zero.
    pub undone: Nanos,
}

/// Whether all deadlines are met.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All are, for ever.
    Meets {
        /// The longest time from a job's release to its completion, for each task in the order of
        /// the set.
        responses: Box<[Nanos]>,
    },
    /// This is the first that is not; the most urgent one, if several fail at that instant.
    Misses(Miss),
    /// The bound cannot promise it. Only [`Method::Bound`] says this.
    Unproven {
        /// The most urgent task for which there is no promise, by its position in the set.
        task: usize,
        /// What it and the more urgent tasks may ask for within one period of it; at least.
        demand: Nanos,
        /// What the windows give in an interval of that length, in the worst phase; less than
        /// `demand`.
        supply: Nanos,
    },
}

/// How much of the supply the tasks use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// The time that the figures are for: the hyperperiod, or where that is beyond nine years, the
    /// frame.
    pub span: Nanos,
    /// What all tasks demand in it. In a frame this is the long-run average, rounded up by at most
    /// a nanosecond for each task.
    pub demand: Nanos,
    /// What the windows give in it; never zero.
    pub supply: Nanos,
}

impl Load {
    fn of(tasks: &TaskSet, supply: &Supply) -> Load {
        let span = tasks.hyperperiod(supply.frame()).unwrap_or(supply.frame());
        // A budget is at most its period: each term fits, and so does the sum, see `SPAN_MAX`.
        let demand = |task: &Task| {
            let work = u128::from(task.budget.0) * u128::from(span.0);
            Nanos(work.div_ceil(u128::from(task.period.0)) as u64)
        };
        Load {
            span,
            demand: tasks.tasks().iter().fold(Nanos::ZERO, |sum, task| sum.plus(demand(task))),
            supply: supply.available(Nanos::ZERO, span),
        }
    }

    /// Demand as a share of the supply, in parts of a thousand, rounded up. Above 1000 no schedule
    /// can help.
    #[must_use]
    pub fn permille(&self) -> u64 {
        let share = (u128::from(self.demand.0) * 1000).div_ceil(u128::from(self.supply.0.max(1)));
        u64::try_from(share).unwrap_or(u64::MAX)
    }

    /// Supply in the span that no task needs, even if every job uses its whole budget.
    #[must_use]
    pub fn idle(&self) -> Nanos {
        self.supply.less(self.demand)
    }
}

/// What is known about a task set in the windows of its partition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Analysis {
    /// How the verdict was reached.
    pub method: Method,
    /// Whether all deadlines are met.
    pub verdict: Verdict,
    /// How much of the supply is used.
    pub load: Load,
}

/// Judges a task set of which something is known beyond periods, budgets and priorities, by the bound: see
/// [`bound_with`].
#[must_use]
pub fn analyse_with(tasks: &TaskSet, rules: &[Rule], supply: &Supply) -> Analysis {
    let load = Load::of(tasks, supply);
    Analysis { method: Method::Bound, verdict: bound_with(tasks, rules, supply), load }
}

/// Judges a task set: exactly if a hyperperiod has at most [`JOBS_MAX`] jobs, and none is released inside of a window in which there
/// may be interrupts; else on the safe side.
#[must_use]
pub fn analyse(tasks: &TaskSet, supply: &Supply) -> Analysis {
    let load = Load::of(tasks, supply);
    match replay(tasks, supply) {
        Some((method, verdict))
            if method == Method::Exact || matches!(verdict, Verdict::Meets { .. }) =>
        {
            Analysis { method, verdict, load }
        }
        _ => Analysis { method: Method::Bound, verdict: bound(tasks, supply), load },
    }
}

#[cfg(test)]
mod tests;
