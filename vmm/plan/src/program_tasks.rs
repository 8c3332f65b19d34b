//! The tasks of programs, as the analysis takes them.
//!
//! An image says how urgent a task is as IEC 61131-3 does, from 0 for the most urgent; the analysis counts
//! the other way round and wants no two alike. So the tasks of all programs are *ranked*, here and nowhere
//! else, in the order in which the guest's kernel ranks them: by priority, then by the program's place
//! in the file, then by the task's place in the image.
//!
//! The tasks begin with some window of the partition: the first one after the guest's start. From there on
//! a cyclic task's releases lie fixed, whatever the schedule. A release that falls into the middle of a
//! window would need a timer that the guest does not have, since it looks at the clock between two jobs and at a
//! window's start; so a file with such a task is refused.

use takt_abi::program::{OBJECTS_MAX, TASKS_MAX};
use takt_program::TaskKind;
use takt_scheduler::analysis::{Rule, Start, Task, TaskSet, TaskSetError};
use takt_scheduler::table::{PartitionId, Table};
use takt_scheduler::time::Nanos;

use super::diagnostic::{Diagnostic, Span, quote};
use super::programs::CheckedProgram;
use super::tasks::{CheckedTasks, NamedTask};

/// What the kernel may take for each job beyond the task's own time: to switch to it and back, and to end it.
pub const JOB_OVERHEAD: Nanos = Nanos::from_micros(1);
/// Most places in a frame at which a task's releases may lie.
const PLACES_MAX: u64 = 100_000;

/// A task of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgramTask {
    /// `PROGRAM.TASK`.
    pub name: String,
    /// Its program's place among those of the partition.
    pub program: usize,
    /// Its place in the image. No version of the program changes it.
    pub number: usize,
    /// When it is released.
    pub release: Release,
    /// As in the image: 0 is the most urgent.
    pub priority: u8,
    /// The longest time that a job should take; `None`: it is not bounded.
    pub budget: Option<Nanos>,
    /// How many jobs one after the other the guest lets exceed it.
    pub sensitivity: u16,
    /// How long after its release a job is due; `None`: it is not.
    pub deadline: Option<Nanos>,
    /// Its place in the analysed set; `None`: it is not analysed.
    pub place: Option<usize>,
}

/// When a task is released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Release {
    /// Each period, first this long after the tasks' beginning.
    Cyclic(Nanos, Nanos),
    /// By an event, with this time between two at the least.
    Event(Nanos),
    /// Whenever nothing else is ready.
    Freewheeling,
}

impl Release {
    /// The least time between two releases; `None` if there is none.
    #[must_use]
    pub const fn period(self) -> Option<Nanos> {
        match self {
            Release::Cyclic(period, _) | Release::Event(period) => Some(period),
            Release::Freewheeling => None,
        }
    }
}

/// How many budgets a job may take. The guest's watchdog lets a job go on to as many as this, and a mixture of longer and shorter
/// jobs delays no job more than if all were that long.
#[must_use]
pub const fn budgets_of_a_job(sensitivity: u16) -> u64 {
    sensitivity as u64 + 1
}

/// The tasks of some programs: what is analysed of them, and all of them, the most urgent first.
pub fn check(programs: &[CheckedProgram]) -> Result<(CheckedTasks, Vec<ProgramTask>), Diagnostic> {
    check_numbers(programs)?;
    let mut all: Vec<ProgramTask> =
        programs.iter().enumerate().flat_map(|(at, p)| tasks_of(at, p)).collect();
    // Stable: what is of one priority stays in the order of the file.
    all.sort_by_key(|task| (task.release == Release::Freewheeling, task.priority));
    let mut checked = CheckedTasks::none();
    for (task, urgency) in all.iter_mut().zip((0..=u8::MAX).rev()) {
        // Below a task without a bound, nothing is bounded.
        let (Some(period), Some(budget)) = (task.release.period(), task.budget) else { break };
        task.place = Some(checked.tasks.len());
        let budgets = budgets_of_a_job(task.sensitivity);
        let budget = Nanos(budget.0.saturating_mul(budgets)).plus(JOB_OVERHEAD);
        let analysed = Task { period, budget, priority: urgency };
        checked.tasks.push(NamedTask { name: task.name.clone(), task: analysed });
        checked.budgets.push(programs[task.program].span.clone());
        checked.multiples.push(budgets);
    }
    let set: Vec<Task> = checked.tasks.iter().map(|task| task.task).collect();
    checked.set = TaskSet::new(&set).map_err(|error| explain(error, &checked))?;
    checked.overhead = JOB_OVERHEAD;
    Ok((checked, all))
}

fn tasks_of(at: usize, checked: &CheckedProgram) -> Vec<ProgramTask> {
    let Some(image) = checked.program.image() else { return Vec::new() };
    let time = |time: takt_program::Nanoseconds| Nanos(time.0);
    let tasks = image.tasks().enumerate().map(|(number, task)| ProgramTask {
        name: format!("{}.{}", checked.program.name, task.name),
        program: at,
        number,
        release: match task.kind {
            TaskKind::Cyclic { period, offset } => Release::Cyclic(time(period), time(offset)),
            TaskKind::Event { minimum, .. } => Release::Event(time(minimum)),
            TaskKind::Freewheeling => Release::Freewheeling,
        },
        priority: task.priority,
        budget: task.budget.map(time),
        sensitivity: task.sensitivity,
        deadline: task.deadline.map(time),
        place: None,
    });
    tasks.collect()
}

/// A guest has room for so many tasks and objects.
fn check_numbers(programs: &[CheckedProgram]) -> Result<(), Diagnostic> {
    let (mut tasks, mut objects) = (0, 0);
    for checked in programs {
        let Some(image) = checked.program.image() else { continue };
        tasks += image.tasks().len() + usize::from(image.init().is_some());
        objects += image.objects().len();
        let too_many = [
            (tasks, TASKS_MAX, "tasks, initialisations included"),
            (objects, OBJECTS_MAX, "objects"),
        ];
        for (count, most, what) in too_many {
            if count > most {
                let found = format!("the programs up to this one have {count} {what}");
                let allowed = format!("at most {most} {what}, in a partition");
                return Err(Diagnostic::new(checked.span.clone(), found, allowed));
            }
        }
    }
    Ok(())
}

fn explain(error: TaskSetError, checked: &CheckedTasks) -> Diagnostic {
    let (task, allowed) = match error {
        TaskSetError::TooMany { .. } => (0, format!("at most {TASKS_MAX} tasks")),
        TaskSetError::ZeroPeriod { task }
        | TaskSetError::ShortPeriod { task, .. }
        | TaskSetError::LongPeriod { task, .. } => (task, "a period of 100 us to a day".to_owned()),
        TaskSetError::ZeroBudget { task } | TaskSetError::BudgetPastPeriod { task, .. } => {
            let times = match checked.multiples.get(task) {
                Some(multiple @ 2..) => {
                    format!("{multiple} times its size, as its sensitivity lets a job take, ")
                }
                _ => String::new(),
            };
            (task, format!("a budget of {times}at most the period, less {JOB_OVERHEAD} to switch"))
        }
        TaskSetError::SamePriority { second, .. } => (second, "different priorities".to_owned()),
    };
    let found = match checked.tasks.get(task) {
        Some(named) => format!("the task {}: {error}", quote(&named.name)),
        None => error.to_string(),
    };
    Diagnostic::new(checked.budgets.get(task).cloned().unwrap_or_default(), found, allowed)
}

/// What is known of the analysed tasks under one of the schedules. `spans` are those of the images.
pub fn rules(
    all: &[ProgramTask],
    programs: &[CheckedProgram],
    partition: PartitionId,
    tables: &[Table],
    table: &Table,
) -> Result<Vec<Rule>, Diagnostic> {
    let bases: Vec<Nanos> =
        tables.iter().flat_map(|table| table.windows_of(partition)).map(|w| w.offset).collect();
    let mut rules = Vec::new();
    for task in all {
        let released = match task.release {
            Release::Cyclic(period, offset) => {
                let places = Places { bases: &bases, period, offset, frame: table.frame() };
                match places.compare(table, partition) {
                    Some(start) => start,
                    None => return Err(inside(task, programs[task.program].span.clone(), period)),
                }
            }
            Release::Event(_) | Release::Freewheeling => Start::Anywhere,
        };
        if let (Some(_), Some(deadline)) = (task.place, task.deadline) {
            rules.push(Rule { deadline, released });
        }
    }
    Ok(rules)
}

/// Where in a frame the jobs of a cyclic task are released.
struct Places<'a> {
    bases: &'a [Nanos],
    period: Nanos,
    offset: Nanos,
    frame: Nanos,
}

impl Places<'_> {
    /// Whether all lie at the beginning of windows, or some between them; `None` if one lies inside of a window.
    fn compare(&self, table: &Table, partition: PartitionId) -> Option<Start> {
        // Multiples of the period, modulo the frame, are the multiples of their common divisor.
        let step = gcd(self.period.0, self.frame.0).max(1);
        if self.frame.0 / step > PLACES_MAX {
            return None;
        }
        let mut start = Start::Window;
        for base in self.bases {
            for k in 0..self.frame.0 / step {
                let place =
                    Nanos((base.0 + self.offset.0 % self.frame.0 + k * step) % self.frame.0);
                let mut windows = table.windows_of(partition);
                match windows.find(|w| w.offset <= place && place < w.end()) {
                    Some(window) if window.offset == place => {}
                    Some(_) => return None,
                    None => start = Start::Outside,
                }
            }
        }
        Some(start)
    }
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

fn inside(task: &ProgramTask, image: Span, period: Nanos) -> Diagnostic {
    let found = format!(
        "jobs of the task {} are released each {period}, some of them in the middle of a window",
        quote(&task.name)
    );
    let allowed = "releases at the beginning of windows, or between them: windows with the task's period, by \
                   the key `period`, or a task with a multiple of theirs";
    Diagnostic::new(image, found, allowed)
}
