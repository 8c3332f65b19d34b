//! Whether a version with other budgets may take the place of one that runs.
//!
//! The analysis of the partition file holds for the tasks that the file's images have. A new version may give a job more
//! time, or make it due sooner. Before it is let in, the analysis is repeated with it. Jobs of both versions can be in one
//! window, and a roll-back leads to the old one again. So each task is taken with the larger budget and the shorter deadline of
//! all versions that may run: what holds for those holds for each mixture, since a job that takes less time makes no other one later.

use takt_program::{Image, Nanoseconds};
use takt_scheduler::analysis::{Rule, Supply, Task, TaskSet, Verdict, analyse_with};
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::Nanos;

use super::diagnostic::quote;
use super::program_tasks::{JOB_OVERHEAD, ProgramTask, budgets_of_a_job};
use super::{NamedTask, PartitionFile};

/// What the analysis of a partition's programs takes.
#[derive(Clone, Debug, Default)]
pub struct Admission {
    all: Vec<ProgramTask>,
    analysed: Vec<NamedTask>,
    /// Name and windows of each schedule, with what is known of the tasks in it.
    schedules: Vec<(String, Supply, Box<[Rule]>)>,
}

impl Admission {
    /// Of a partition of a file.
    #[must_use]
    pub fn of(file: &PartitionFile, partition: PartitionId) -> Self {
        let Some(owner) = file.partitions().get(partition.0) else { return Self::default() };
        let schedules = owner.met.iter().filter_map(|met| {
            let table = file.schedules().tables().get(met.schedule.0)?;
            let name = file.schedule_names().get(met.schedule.0)?;
            let interrupts = met.interrupts.time();
            let supply = Supply::of(table, partition, met.wake_up, interrupts).ok()?;
            Some((name.clone(), supply, met.rules.clone()))
        });
        Self {
            schedules: schedules.collect(),
            all: owner.program_tasks.clone(),
            analysed: owner.tasks.clone(),
        }
    }

    /// Whether all deadlines are met while these versions may run, each with the place of its program in the file. Their
    /// tasks are those of the file's images, with other budgets and deadlines.
    ///
    /// # Errors
    /// What is not met.
    pub fn check(&self, versions: &[(usize, Image<'_>)]) -> Result<(), String> {
        let (mut tasks, mut deadlines): (Vec<Task>, Vec<Nanos>) = (Vec::new(), Vec::new());
        for task in self.all.iter().filter(|task| task.place.is_some()) {
            let (mut budget, mut deadline) = (Nanos::ZERO, None);
            for found in limits(task, versions) {
                let Some((needs, due)) = found else {
                    return Err(format!("the task {} has no budget", quote(&task.name)));
                };
                budget = budget.max(needs);
                deadline = deadline.into_iter().chain(due).min();
            }
            let Some(known) = self.analysed.get(tasks.len()) else { break };
            tasks.push(Task { budget: budget.plus(JOB_OVERHEAD), ..known.task });
            deadlines.push(deadline.unwrap_or(known.task.period));
        }
        let set = TaskSet::new(&tasks).map_err(|error| error.to_string())?;
        for (name, supply, rules) in &self.schedules {
            let rules: Vec<Rule> = rules
                .iter()
                .zip(&deadlines)
                .map(|(rule, deadline)| Rule { deadline: *deadline, ..*rule })
                .collect();
            let verdict = analyse_with(&set, &rules, supply).verdict;
            let (task, what) = match verdict {
                Verdict::Meets { .. } => continue,
                Verdict::Misses(miss) => (
                    miss.task,
                    format!(
                        "misses its deadline: released at {}, due at {}, {} undone",
                        miss.release, miss.deadline, miss.undone
                    ),
                ),
                Verdict::Unproven { task, demand, supply } => (
                    task,
                    format!(
                        "is not proven to meet its deadlines: it and the more urgent tasks may ask for {demand}, and the windows \
                         may give only {supply}"
                    ),
                ),
            };
            let task = self.analysed.get(task).map_or("?", |task| &task.name);
            return Err(format!(
                "with the larger budgets of both versions, in the schedule {} the task {} {what}",
                quote(name),
                quote(task)
            ));
        }
        Ok(())
    }
}

/// What a job may take and its deadline, as each version of a task's program says; none if it gives no budget.
fn limits<'a>(
    task: &'a ProgramTask,
    versions: &'a [(usize, Image<'_>)],
) -> impl Iterator<Item = Option<(Nanos, Option<Nanos>)>> + 'a {
    let time = |time: Nanoseconds| Nanos(time.0);
    versions.iter().filter(|(place, _)| *place == task.program).map(move |(_, image)| {
        let found = image.tasks().nth(task.number)?;
        let longest = found.budget?.0.saturating_mul(budgets_of_a_job(found.sensitivity));
        Some((Nanos(longest), found.deadline.map(time)))
    })
}
