//! The tasks of a PLC: the rules for each, and among those of one partition.
//!
//! Whether they meet their deadlines depends on the schedules and is looked at later, in
//! [`super::deadlines`].

use takt_scheduler::analysis::{
    FrameError, PERIOD_MAX, PERIOD_MIN, TASKS_MAX, Task, TaskSet, TaskSetError,
};
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::names::check_name;
use super::raw::{self, Keys};
use super::units::Duration;

/// A task of a partition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedTask {
    /// Unique among the tasks of the partition.
    pub name: String,
    /// What the analysis knows of it.
    pub task: Task,
}

/// Tasks that are well-formed, with the places that the analysis points at.
#[derive(Debug)]
pub struct CheckedTasks {
    pub set: TaskSet,
    pub tasks: Vec<NamedTask>,
    /// The place for each task that says how long it takes.
    pub budgets: Vec<Span>,
    /// How often each budget counts that the place says.
    pub multiples: Vec<u64>,
    /// What was added to each then.
    pub overhead: Nanos,
}

impl CheckedTasks {
    /// No tasks.
    pub fn none() -> CheckedTasks {
        let set = TaskSet::default();
        let (tasks, budgets, multiples) = (Vec::new(), Vec::new(), Vec::new());
        CheckedTasks { set, tasks, budgets, multiples, overhead: Nanos::ZERO }
    }
}

/// Checks the tasks of one partition, in the order of the file.
pub fn check(
    tables: &[Spanned<Keys<raw::Task>>],
    frame: &Spanned<Duration>,
) -> Result<CheckedTasks, Diagnostic> {
    if tables.len() > TASKS_MAX {
        // Before names are compared: those of thousands would take long.
        return Err(explain(TaskSetError::TooMany { count: tables.len() }, tables, &[]));
    }
    let mut tasks: Vec<NamedTask> = Vec::with_capacity(tables.len());
    for table in tables {
        let Keys(raw) = table.get_ref();
        let name = check_name(&raw.name)?;
        if let Some(other) = tasks.iter().position(|task| task.name == name) {
            let found = format!("a second task of the partition is named {}", quote(name));
            let allowed = "a name of its own for each task of a partition";
            return Err(Diagnostic::new(raw.name.span(), found, allowed)
                .and(tables[other].get_ref().0.name.span(), "the other one"));
        }
        let task = Task {
            period: raw.period.get_ref().0,
            budget: raw.budget.get_ref().0,
            priority: check_priority(&raw.priority)?,
        };
        tasks.push(NamedTask { name: name.to_owned(), task });
    }
    let set = TaskSet::new(&tasks.iter().map(|t| t.task).collect::<Vec<_>>())
        .map_err(|error| explain(error, tables, &tasks))?;
    let length = frame.get_ref().0;
    set.fits_frame(length).map_err(|error| {
        let FrameError { task, .. } = error;
        let allowed = format!(
            "a period of which {length} is a whole multiple, or one that is such a multiple"
        );
        let span = tables[task].get_ref().0.period.span();
        Diagnostic::new(span, error.to_string(), allowed).and(frame.span(), "the major frame")
    })?;
    let budgets = tables.iter().map(|table| table.get_ref().0.budget.span()).collect();
    let multiples = vec![1; tasks.len()];
    Ok(CheckedTasks { set, tasks, budgets, multiples, overhead: Nanos::ZERO })
}

fn check_priority(priority: &Spanned<i64>) -> Result<u8, Diagnostic> {
    let number = *priority.get_ref();
    u8::try_from(number).map_err(|_| {
        let found = format!("{number} is not a priority");
        let allowed = "0 to 255; a higher number is more urgent";
        Diagnostic::new(priority.span(), found, allowed)
    })
}

fn explain(
    error: TaskSetError,
    tables: &[Spanned<Keys<raw::Task>>],
    tasks: &[NamedTask],
) -> Diagnostic {
    let raw = |task: usize| &tables[task].get_ref().0;
    let period = |task: usize| {
        let length = tasks[task].task.period;
        let long = length > PERIOD_MAX;
        let found =
            format!("the period of {length} is too {}", if long { "long" } else { "short" });
        let allowed = format!("{PERIOD_MIN} to {PERIOD_MAX}");
        Diagnostic::new(raw(task).period.span(), found, allowed)
    };
    match error {
        TaskSetError::TooMany { count } => {
            let excess = tables.get(TASKS_MAX).map_or(0..0, Spanned::span);
            let found = format!("this is task {} of {count}", TASKS_MAX + 1);
            let allowed = format!("at most {TASKS_MAX} tasks in a partition");
            Diagnostic::new(excess, found, allowed)
        }
        TaskSetError::ZeroPeriod { task }
        | TaskSetError::ShortPeriod { task, .. }
        | TaskSetError::LongPeriod { task, .. } => period(task),
        TaskSetError::ZeroBudget { task } => {
            let found = format!("the budget of {}: the task would never run", Nanos::ZERO);
            let allowed = "more than nothing, and at most the period of the task";
            Diagnostic::new(raw(task).budget.span(), found, allowed)
        }
        TaskSetError::BudgetPastPeriod { task, .. } => {
            let allowed = "a budget of at most the period: a job is due when the next one starts";
            Diagnostic::new(raw(task).budget.span(), error.to_string(), allowed)
                .and(raw(task).period.span(), "the period")
        }
        TaskSetError::SamePriority { first, second, priority } => {
            let other = quote(&tasks[first].name);
            let found = format!("the priority {priority} is that of the task {other} too");
            let allowed = "a priority of its own for each task: which goes first must be certain";
            Diagnostic::new(raw(second).priority.span(), found, allowed)
                .and(raw(first).priority.span(), "the other one")
        }
    }
}
