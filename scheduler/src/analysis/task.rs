//! The tasks of one partition.
//!
//! A [`TaskSet`] exists only if it is well-formed, so that the analysis has no error cases. Being
//! well-formed is not being schedulable: that is the analysis' own answer.

use thiserror::Error;

use crate::time::Nanos;

/// Shortest period of a task. The shortest major frame is as long: see
/// [`FRAME_MIN`](crate::table::FRAME_MIN).
pub const PERIOD_MIN: Nanos = Nanos::from_micros(100);
/// Longest period of a task, a day: what comes less often is not a matter of real time.
pub const PERIOD_MAX: Nanos = Nanos::from_millis(86_400_000);
/// Most tasks in a set: as many as fit one machine word of ready flags.
pub const TASKS_MAX: usize = 64;
/// Longest hyperperiod that is looked at, about nine years. The demand of all tasks in it fits the
/// type, since none demands more than the whole time.
const SPAN_MAX: u64 = u64::MAX / TASKS_MAX as u64;

/// A periodic task. Its jobs are released at the epoch and then every period, and each is due at
/// the release of the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    /// Time from release to release, and from a release to its deadline.
    pub period: Nanos,
    /// Worst-case execution time of a job, with what it costs to switch to it and back.
    pub budget: Nanos,
    /// A higher number is more urgent.
    pub priority: u8,
}

/// Why a task set is not well-formed. Tasks are given by their position in the input, so that a
/// caller can point at the line they came from.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum TaskSetError {
    /// More than [`TASKS_MAX`] tasks.
    #[error("{count} tasks are more than the {TASKS_MAX} that a partition can have")]
    TooMany {
        /// How many there are.
        count: usize,
    },
    /// A period of zero.
    #[error("task {task} has no period")]
    ZeroPeriod {
        /// The task.
        task: usize,
    },
    /// A period shorter than [`PERIOD_MIN`].
    #[error("the period of {period} is shorter than the shortest allowed, {PERIOD_MIN}")]
    ShortPeriod {
        /// The task.
        task: usize,
        /// Its period.
        period: Nanos,
    },
    /// A period longer than [`PERIOD_MAX`].
    #[error("the period of {period} is longer than the longest allowed, {PERIOD_MAX}")]
    LongPeriod {
        /// The task.
        task: usize,
        /// Its period.
        period: Nanos,
    },
    /// A budget of zero.
    #[error("task {task} has no budget: it would never run")]
    ZeroBudget {
        /// The task.
        task: usize,
    },
    /// A budget longer than the period.
    #[error("the budget of {budget} is longer than the period of {period}")]
    BudgetPastPeriod {
        /// The task.
        task: usize,
        /// Its budget.
        budget: Nanos,
        /// Its period.
        period: Nanos,
    },
    /// Two tasks of one priority: which goes first would be an accident.
    #[error("task {second} has the priority {priority}, which task {first} has already")]
    SamePriority {
        /// The first.
        first: usize,
        /// The second.
        second: usize,
        /// Their priority.
        priority: u8,
    },
}

/// A task whose period and the major frame are not multiples of each other, either way.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error(
    "the period of {period} neither divides the major frame of {frame} nor is a multiple of it"
)]
pub struct FrameError {
    /// The task, by its position in the set.
    pub task: usize,
    /// Its period.
    pub period: Nanos,
    /// The frame.
    pub frame: Nanos,
}

/// A well-formed set of tasks; may be empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskSet {
    tasks: Box<[Task]>,
    /// Positions in `tasks`, the most urgent first.
    order: Box<[usize]>,
}

impl TaskSet {
    /// Checks tasks and makes them a set. They may be in any order.
    ///
    /// # Errors
    /// The first rule that is broken, see [`TaskSetError`].
    pub fn new(tasks: &[Task]) -> Result<TaskSet, TaskSetError> {
        if tasks.len() > TASKS_MAX {
            return Err(TaskSetError::TooMany { count: tasks.len() });
        }
        for (task, &Task { period, budget, priority }) in tasks.iter().enumerate() {
            if period == Nanos::ZERO {
                return Err(TaskSetError::ZeroPeriod { task });
            }
            if period < PERIOD_MIN {
                return Err(TaskSetError::ShortPeriod { task, period });
            }
            if period > PERIOD_MAX {
                return Err(TaskSetError::LongPeriod { task, period });
            }
            if budget == Nanos::ZERO {
                return Err(TaskSetError::ZeroBudget { task });
            }
            if budget > period {
                return Err(TaskSetError::BudgetPastPeriod { task, budget, period });
            }
            if let Some(first) = tasks[..task].iter().position(|t| t.priority == priority) {
                return Err(TaskSetError::SamePriority { first, second: task, priority });
            }
        }
        let mut order: Box<[usize]> = (0..tasks.len()).collect();
        order.sort_by_key(|&task| std::cmp::Reverse(tasks[task].priority));
        Ok(TaskSet { tasks: tasks.into(), order })
    }

    /// The tasks, in the order of the input.
    #[must_use]
    pub fn tasks(&self) -> &[Task] {
        &self.tasks
    }

    /// The tasks with their positions in the input, the most urgent first.
    pub fn by_urgency(&self) -> impl Iterator<Item = (usize, &Task)> {
        self.order.iter().map(|&task| (task, &self.tasks[task]))
    }

    /// Checks that each period divides the frame or is a multiple of it.
    ///
    /// ARINC 653 Part 1 asks the former of partitions: the major frame is a multiple of the least
    /// common multiple of their periods. Slower tasks, with a period of several frames, keep what
    /// the rule is for: a task meets the windows in the same phase again and again, and its jobs do
    /// not wander through them.
    ///
    /// The analysis does not need this: it answers for any periods.
    ///
    /// # Errors
    /// The first task, in the order of the input, for which neither holds.
    pub fn fits_frame(&self, frame: Nanos) -> Result<(), FrameError> {
        let fits =
            |period: Nanos| frame.0.is_multiple_of(period.0) || period.0.is_multiple_of(frame.0);
        match self.tasks.iter().position(|t| !fits(t.period)) {
            None => Ok(()),
            Some(task) => Err(FrameError { task, period: self.tasks[task].period, frame }),
        }
    }

    /// The least common multiple of all periods and the frame: after it, releases and windows
    /// repeat. `None` if it is longer than nine years. `frame` is not zero.
    pub(super) fn hyperperiod(&self, frame: Nanos) -> Option<Nanos> {
        let mut span = frame.0;
        for task in &self.tasks {
            let period = task.period.0;
            span = (span / gcd(span, period)).checked_mul(period).filter(|s| *s <= SPAN_MAX)?;
        }
        Some(Nanos(span))
    }
}

/// Greatest common divisor, by Euclid; of zero and another number that number.
fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    fn task(period: u64, budget: u64, priority: u8) -> Task {
        Task { period: us(period), budget: us(budget), priority }
    }

    /// A good task first, so that a wrong index shows.
    fn refused(second: Task) -> TaskSetError {
        TaskSet::new(&[task(1000, 100, 1), second]).unwrap_err()
    }

    #[test]
    fn each_rule_names_the_task_that_breaks_it() {
        use TaskSetError as E;
        assert_eq!(refused(task(0, 0, 2)), E::ZeroPeriod { task: 1 });
        assert_eq!(refused(task(99, 10, 2)), E::ShortPeriod { task: 1, period: us(99) });
        let period = us(86_400_000_001);
        assert_eq!(refused(task(86_400_000_001, 10, 2)), E::LongPeriod { task: 1, period });
        assert_eq!(refused(task(100, 0, 2)), E::ZeroBudget { task: 1 });
        let (budget, period) = (us(101), us(100));
        assert_eq!(refused(task(100, 101, 2)), E::BudgetPastPeriod { task: 1, budget, period });
        assert_eq!(
            refused(task(100, 100, 1)),
            E::SamePriority { first: 0, second: 1, priority: 1 }
        );
        assert!(TaskSet::new(&[task(1000, 100, 1), task(100, 100, 2)]).is_ok());
    }

    #[test]
    fn sixty_four_tasks_are_the_most() {
        let tasks: Vec<Task> = (0..65).map(|priority| task(1000, 1, priority)).collect();
        assert!(TaskSet::new(&tasks[..64]).is_ok());
        assert_eq!(TaskSet::new(&tasks), Err(TaskSetError::TooMany { count: 65 }));
    }

    #[test]
    fn urgency_goes_down_and_positions_stay() {
        let set = TaskSet::new(&[task(100, 1, 3), task(200, 1, 255), task(300, 1, 0)]).unwrap();
        let order: Vec<usize> = set.by_urgency().map(|(task, _)| task).collect();
        assert_eq!(order, [1, 0, 2]);
        assert_eq!(set.tasks()[2].period, us(300));
    }

    #[test]
    fn a_period_divides_the_frame_or_is_a_multiple_of_it() {
        let set = |period| TaskSet::new(&[task(1000, 1, 1), task(period, 1, 2)]).unwrap();
        for period in [100, 250, 500, 1000, 2000, 7000] {
            assert_eq!(set(period).fits_frame(us(1000)), Ok(()), "{period}");
        }
        for period in [300, 999, 1500] {
            let error = FrameError { task: 1, period: us(period), frame: us(1000) };
            assert_eq!(set(period).fits_frame(us(1000)), Err(error));
        }
    }

    #[test]
    fn the_hyperperiod_covers_frame_and_periods() {
        let set = TaskSet::new(&[task(400, 1, 1), task(600, 1, 2)]).unwrap();
        assert_eq!(set.hyperperiod(us(1000)), Some(us(6000)));
        assert_eq!(TaskSet::new(&[]).unwrap().hyperperiod(us(1000)), Some(us(1000)));
    }

    #[test]
    fn a_hyperperiod_of_more_than_nine_years_is_none() {
        // Primes near a million: with this frame one makes 17 minutes, two make 31 years.
        let prime = |period, priority| Task { period: Nanos(period), budget: us(1), priority };
        let tasks = [prime(1_000_003, 1), prime(1_000_033, 2)];
        let span = |tasks| TaskSet::new(tasks).unwrap().hyperperiod(us(1000));
        assert_eq!(span(&tasks[..1]), Some(Nanos(1_000_003_000_000)));
        assert_eq!(span(&tasks), None);
    }
}
