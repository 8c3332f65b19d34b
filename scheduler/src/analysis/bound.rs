//! The safe answer: response times bounded without knowing the phase.
//!
//! Let a job be released at *r*, and let *s* be the last instant up to *r* at which no more urgent
//! work was pending. From *s* until the job is complete, every open window serves it or more urgent
//! jobs released since *s*, provided that its own predecessor was complete at *r*. So it is
//! complete as soon as the least supply in any interval of a length *L* covers what can be demanded
//! in one: its own budget, and that of ⌈*L* / period⌉ jobs of each more urgent task. The bound is
//! the smallest such *L*, found by iteration from below: the response-time analysis of Joseph and
//! Pandya (1986), with the supply bound function of Shin and Lee (2003) for the processor. If it
//! does not exceed the period, the proviso holds for all jobs in turn.
//!
//! Nothing here relies on when tasks are released, only on the time between two releases. What is known
//! of that makes the bound smaller: *s* is the release of a job, the task's own or a more urgent one. If all
//! of these are released at the beginning of windows ([`Rule::released`]), *s* is such a beginning, and
//! only intervals that start there need to be looked at. If none is released inside a window, *s* lies in none.

use super::{Start, Supply, Task, TaskSet, Verdict};
use crate::time::Nanos;

/// Least and most steps of one iteration. Tens are usual; only near full load over a long period
/// are there more.
const STEPS: [usize; 2] = [20, 1_000];
/// Most windows that all steps for a set look at, unless the least steps take more: a tenth of a
/// second of work. Each step looks at all windows of a frame, and there may be thousands.
const VISITS_MAX: usize = 1_000_000;

/// What is known of a task beyond its period, its budget and its priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// How long after its release a job is due; at most the period.
    pub deadline: Nanos,
    /// Where all jobs are released.
    pub released: Start,
}

impl Rule {
    /// Of a task of which nothing is known.
    #[must_use]
    pub const fn of(task: &Task) -> Rule {
        Rule { deadline: task.period, released: Start::Anywhere }
    }
}

/// Bounds the response time of each task.
#[must_use]
pub fn bound(tasks: &TaskSet, supply: &Supply) -> Verdict {
    let rules: Vec<Rule> = tasks.tasks().iter().map(Rule::of).collect();
    bound_with(tasks, &rules, supply)
}

/// Bounds the response time of each task, with a rule for each, in the order of the set. A task without
/// one has [`Rule::of`] it.
#[must_use]
pub fn bound_with(tasks: &TaskSet, rules: &[Rule], supply: &Supply) -> Verdict {
    let mut responses = vec![Nanos::ZERO; tasks.tasks().len()];
    let mut higher = Vec::new();
    let visits = responses.len().saturating_mul(supply.slots_per_frame()).max(1);
    let steps = (VISITS_MAX / visits).clamp(STEPS[0], STEPS[1]);
    let mut start = Start::Window;
    for (position, task) in tasks.by_urgency() {
        let rule = rules.get(position).copied().unwrap_or(Rule::of(task));
        start = start.max(rule.released);
        let supply = Least { supply, start };
        match response(task, rule.deadline, &higher, supply, steps) {
            Some(response) => responses[position] = response,
            None => {
                return Verdict::Unproven {
                    task: position,
                    demand: demand(task, &higher, rule.deadline),
                    supply: supply.minimum(rule.deadline),
                };
            }
        }
        higher.push(*task);
    }
    Verdict::Meets { responses: responses.into() }
}

/// What windows give at the least in an interval that begins so.
#[derive(Clone, Copy)]
struct Least<'a> {
    supply: &'a Supply,
    start: Start,
}

impl Least<'_> {
    fn minimum(self, length: Nanos) -> Nanos {
        self.supply.minimum(self.start, length)
    }

    fn longest(self, demand: Nanos) -> Option<Nanos> {
        self.supply.longest(self.start, demand)
    }
}

/// A bound of the task's response time that does not exceed its deadline, or `None`.
///
/// Every length whose least supply covers its demand is a bound, not only the smallest. So where
/// the iteration takes too long the deadline itself is tried, and `None` always means that it too is
/// no bound: no iterate exceeds a length that is one.
fn response(
    task: &Task,
    deadline: Nanos,
    higher: &[Task],
    supply: Least<'_>,
    steps: usize,
) -> Option<Nanos> {
    let mut length = Nanos::ZERO;
    for _ in 0..steps {
        let next = supply.longest(demand(task, higher, length))?;
        if next > deadline {
            return None;
        }
        if next == length {
            return Some(length);
        }
        length = next;
    }
    let covered = supply.minimum(deadline) >= demand(task, higher, deadline);
    covered.then_some(deadline)
}

/// The most that the task and more urgent ones can ask for in an interval of `length`, which is at
/// most [`PERIOD_MAX`](super::PERIOD_MAX): 64 tasks ask for less than two such periods each.
fn demand(task: &Task, higher: &[Task], length: Nanos) -> Nanos {
    higher.iter().fold(task.budget, |sum, rival| {
        sum.plus(Nanos(length.0.div_ceil(rival.period.0) * rival.budget.0))
    })
}
