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
//! Nothing here relies on when tasks are released, only on the time between two releases.

use super::{Supply, Task, TaskSet, Verdict};
use crate::time::Nanos;

/// Least and most steps of one iteration. Tens are usual; only near full load over a long period
/// are there more.
const STEPS: [usize; 2] = [20, 1_000];
/// Most windows that all steps for a set look at, unless the least steps take more: a tenth of a
/// second of work. Each step looks at all windows of a frame, and there may be thousands.
const VISITS_MAX: usize = 1_000_000;

/// Bounds the response time of each task.
#[must_use]
pub fn bound(tasks: &TaskSet, supply: &Supply) -> Verdict {
    let mut responses = vec![Nanos::ZERO; tasks.tasks().len()];
    let mut higher = Vec::new();
    let visits = responses.len().saturating_mul(supply.slots_per_frame()).max(1);
    let steps = (VISITS_MAX / visits).clamp(STEPS[0], STEPS[1]);
    for (position, task) in tasks.by_urgency() {
        match response(task, &higher, supply, steps) {
            Some(response) => responses[position] = response,
            None => {
                return Verdict::Unproven {
                    task: position,
                    demand: demand(task, &higher, task.period),
                    supply: supply.minimum(task.period),
                };
            }
        }
        higher.push(*task);
    }
    Verdict::Meets { responses: responses.into() }
}

/// A bound of the task's response time that does not exceed its period, or `None`.
///
/// Every length whose least supply covers its demand is a bound, not only the smallest. So where
/// the iteration takes too long the period itself is tried, and `None` always means that it too is
/// no bound: no iterate exceeds a length that is one.
fn response(task: &Task, higher: &[Task], supply: &Supply, steps: usize) -> Option<Nanos> {
    let mut length = Nanos::ZERO;
    for _ in 0..steps {
        let next = supply.longest(demand(task, higher, length))?;
        if next > task.period {
            return None;
        }
        if next == length {
            return Some(length);
        }
        length = next;
    }
    let covered = supply.minimum(task.period) >= demand(task, higher, task.period);
    covered.then_some(task.period)
}

/// The most that the task and more urgent ones can ask for in an interval of `length`, which is at
/// most [`PERIOD_MAX`](super::PERIOD_MAX): 64 tasks ask for less than two such periods each.
fn demand(task: &Task, higher: &[Task], length: Nanos) -> Nanos {
    higher.iter().fold(task.budget, |sum, rival| {
        sum.plus(Nanos(length.0.div_ceil(rival.period.0) * rival.budget.0))
    })
}
