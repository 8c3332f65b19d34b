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

use takt_abi::program::{EVENTS_MAX, OBJECTS_MAX, TASKS_MAX};
use takt_program::TaskKind;
use takt_scheduler::analysis::{PERIOD_MIN, Rule, Start, Task, TaskSet, TaskSetError};
use takt_scheduler::table::{PartitionId, Table};
use takt_scheduler::time::Nanos;

use super::diagnostic::{Diagnostic, Span, quote};
use super::programs::CheckedProgram;
use super::tasks::{CheckedTasks, NamedTask};

/// What the kernel may take for each job beyond the task's own time: to switch to it and back, and to end it.
pub const JOB_OVERHEAD: Nanos = Nanos::from_micros(1);

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
    let too_often = |task: &&ProgramTask| matches!(task.release, Release::Event(minimum) if minimum < PERIOD_MIN);
    if let Some(task) = all.iter().find(too_often) {
        return Err(often(task, programs[task.program].span.clone()));
    }
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
    let (mut tasks, mut events, mut objects) = (0, 0, 0);
    for checked in programs {
        let Some(image) = checked.program.image() else { continue };
        tasks += image.tasks().len() + usize::from(image.init().is_some());
        let event = |task: &takt_program::Task<'_>| matches!(task.kind, TaskKind::Event { .. });
        events += image.tasks().filter(event).count();
        objects += image.objects().len();
        let too_many = [
            (tasks, TASKS_MAX, "tasks, initialisations included"),
            (events, EVENTS_MAX, "event tasks"),
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
    ///
    /// There may be thousands of bases, places for each, and windows. So the places are never listed: each window looks for
    /// the next place behind its beginning.
    fn compare(&self, table: &Table, partition: PartitionId) -> Option<Start> {
        // Multiples of the period, modulo the frame, are the multiples of their common divisor.
        let step = gcd(self.period.0, self.frame.0).max(1);
        let phase = |base: &Nanos| (base.0 % step + self.offset.0 % step) % step;
        let mut phases: Vec<u64> = self.bases.iter().map(phase).collect();
        phases.sort_unstable();
        phases.dedup();
        let mut at_starts = 0;
        for window in table.windows_of(partition) {
            let own = window.offset.0 % step;
            let later = phases.partition_point(|phase| *phase <= own);
            let around = || phases.first().map(|phase| phase + step);
            let next = phases.get(later).copied().or_else(around)?;
            if next - own < window.duration.0 {
                return None;
            }
            at_starts += u64::from(phases[..later].last() == Some(&own));
        }
        // No two windows of a partition begin together, and no two places are the same.
        let places = phases.len() as u64 * (self.frame.0 / step);
        Some(if at_starts == places { Start::Window } else { Start::Outside })
    }
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// The guest looks for events before each job, and would do nothing else.
fn often(task: &ProgramTask, image: Span) -> Diagnostic {
    let minimum = task.release.period().unwrap_or(Nanos::ZERO);
    let found = format!("events may release the task {} each {minimum}", quote(&task.name));
    Diagnostic::new(image, found, format!("at least {PERIOD_MIN} from one release to the next"))
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

#[cfg(test)]
mod tests {
    use takt_scheduler::table::{Cpu, Placement, Role, Window};

    use super::*;

    const PLC: PartitionId = PartitionId(0);

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    /// With windows of this offset, duration and period in us.
    fn table(frame: u64, windows: &[(u64, u64, u64)]) -> Table {
        let placement = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::ZERO } };
        let window = |&(offset, duration, period)| Window {
            partition: PLC,
            offset: us(offset),
            duration: us(duration),
            period: us(period),
        };
        let windows: Vec<Window> = windows.iter().map(window).collect();
        Table::new(us(frame), &[placement], &windows).unwrap()
    }

    fn bases(table: &Table) -> Vec<Nanos> {
        table.windows_of(PLC).map(|window| window.offset).collect()
    }

    /// Place by place, and window by window.
    fn listed(places: &Places<'_>, table: &Table) -> Option<Start> {
        let mut start = Start::Window;
        for base in places.bases {
            for job in 0..places.frame.0 / gcd(places.period.0, places.frame.0) {
                let release = base.0 + places.offset.0 + job * places.period.0;
                let place = Nanos(release % places.frame.0);
                let mut windows = table.windows_of(PLC);
                match windows.find(|w| w.offset <= place && place < w.end()) {
                    Some(window) if window.offset == place => {}
                    Some(_) => return None,
                    None => start = Start::Outside,
                }
            }
        }
        Some(start)
    }

    #[test]
    fn places_are_those_that_are_found_one_by_one() {
        let mut found = [0; 3];
        let tables = [
            table(1_000, &[(0, 100, 250)]),
            table(1_000, &[(50, 100, 1_000), (300, 150, 1_000)]),
            table(1_200, &[(0, 100, 300), (150, 100, 600)]),
            table(1_200, &[(100, 50, 1_200), (700, 400, 1_200)]),
            table(1_000, &[(0, 1_000, 1_000)]),
        ];
        for (table, other) in tables.iter().flat_map(|a| tables.iter().map(move |b| (a, b))) {
            let both = [bases(table), bases(other)].concat();
            for (bases, period) in [bases(table), both]
                .iter()
                .flat_map(|bases| [100, 250, 300, 350, 500, 600, 1_000, 2_400].map(|p| (bases, p)))
            {
                for offset in [0, 50, 100, 150, 249, 300, 1_250] {
                    let (period, offset) = (us(period), us(offset));
                    let places = Places { bases, period, offset, frame: table.frame() };
                    let start = places.compare(table, PLC);
                    assert_eq!(start, listed(&places, table), "{table:?} {period} {offset}");
                    found[start.map_or(2, |start| start as usize)] += 1;
                }
            }
        }
        assert!(found.iter().all(|count| *count > 20), "{found:?}");
    }

    /// Each window with each place would be 64 thousand million comparisons, and this test would not end.
    #[test]
    fn of_thousands_of_windows_and_places_none_are_listed() {
        let table = table(4_000_000, &[(0, 300, 1_000)]);
        let bases = bases(&table);
        let at = |offset| {
            let (period, offset) = (us(1_000), us(offset));
            Places { bases: &bases, period, offset, frame: table.frame() }.compare(&table, PLC)
        };
        assert_eq!([0, 300, 299].map(at), [Some(Start::Window), Some(Start::Outside), None]);
    }
}
