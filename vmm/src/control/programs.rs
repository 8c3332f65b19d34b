//! How programs and tasks stand, for the status.
//!
//! The figures are claims of the guest's kernel. Names and the number of programs are those of the partition file, so a
//! guest cannot make up either.

use takt_abi::live::{ProgramRecord, ProgramState, TaskRecord, TaskState};

use super::facts::ProgramFacts;
use super::protocol::{self, ProgramStatus, TaskStatus};
use crate::live::Figures;

/// The programs of a partition. If its guest is not up, nothing runs there, whatever its kernel has said last.
pub(super) fn status(
    programs: &[ProgramFacts],
    figures: Option<&Figures>,
    up: bool,
) -> Vec<ProgramStatus> {
    let status = |(place, program): (usize, &ProgramFacts)| {
        let record = figures.and_then(|figures| figures.programs.get(place));
        let tasks = figures.map_or(&[][..], |figures| &figures.tasks);
        let own = tasks.iter().filter(|task| usize::from(task.program) == place);
        ProgramStatus {
            name: program.name.clone(),
            state: record.map(|record| program_state(record.state, up)),
            image: record.map(hash),
            tasks: own.filter_map(|task| task_status(program, task, up)).collect(),
        }
    };
    programs.iter().enumerate().map(status).collect()
}

fn hash(record: &ProgramRecord) -> String {
    record.hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn program_state(state: ProgramState, up: bool) -> protocol::ProgramState {
    match state {
        ProgramState::Starting | ProgramState::Running if !up => protocol::ProgramState::Stopped,
        ProgramState::Stopped => protocol::ProgramState::Stopped,
        ProgramState::Starting => protocol::ProgramState::Starting,
        ProgramState::Running => protocol::ProgramState::Running,
        ProgramState::Faulted => protocol::ProgramState::Faulted,
    }
}

/// `None` for a task that the image does not have.
fn task_status(program: &ProgramFacts, task: &TaskRecord, up: bool) -> Option<TaskStatus> {
    let name = match task.number {
        None => "init",
        Some(number) => program.tasks.get(usize::from(number))?,
    };
    let measured = |span: u64| (span != u64::MAX).then_some(span);
    Some(TaskStatus {
        name: name.to_owned(),
        state: match task.state {
            TaskState::Waiting | TaskState::Ready if !up => protocol::TaskState::Dormant,
            TaskState::Dormant => protocol::TaskState::Dormant,
            TaskState::Waiting => protocol::TaskState::Waiting,
            TaskState::Ready => protocol::TaskState::Ready,
            TaskState::Faulted => protocol::TaskState::Faulted,
        },
        jobs: task.jobs,
        missed: task.misses,
        overruns: task.overruns,
        skipped: task.skipped,
        execution_min_ns: measured(task.executed_min),
        execution_max_ns: task.executed_max,
        execution_sum_ns: task.executed,
        response_max_ns: task.response_max,
        start_max_ns: task.start_max,
        slack_min_ns: measured(task.slack_min),
        switches: task.switches,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_guest_makes_up_is_in_no_status() {
        let programs = [ProgramFacts { name: "a".into(), tasks: vec!["main".into()] }];
        let task = |program, number| TaskRecord { program, number, ..TaskRecord::default() };
        let mut figures = Figures::default();
        figures.programs = vec![ProgramRecord::default(); 16];
        figures.tasks = vec![task(0, Some(0)), task(0, Some(1)), task(1, Some(0)), task(0, None)];
        let told = status(&programs, Some(&figures), true);
        assert_eq!(told.len(), 1);
        let names: Vec<&str> = told[0].tasks.iter().map(|task| task.name.as_str()).collect();
        assert_eq!(names, ["main", "init"]);
        assert_eq!(told[0].image.as_ref().unwrap().len(), 64);
        assert_eq!(status(&programs, None, true)[0].state, None);
    }

    #[test]
    fn nothing_runs_in_a_partition_whose_guest_has_ended() {
        let programs = [ProgramFacts { name: "a".into(), tasks: vec!["main".into()] }];
        let told = |state, task, up| {
            let mut figures = Figures::default();
            figures.programs = vec![ProgramRecord { state, ..ProgramRecord::default() }];
            let task =
                TaskRecord { number: Some(0), state: task, jobs: 7, ..TaskRecord::default() };
            figures.tasks = vec![task];
            let [told] = &status(&programs, Some(&figures), up)[..] else { panic!() };
            (told.state.unwrap(), told.tasks[0].state, told.tasks[0].jobs)
        };
        use protocol::{ProgramState as P, TaskState as T};
        let running = (ProgramState::Running, TaskState::Waiting);
        assert_eq!(told(running.0, running.1, true), (P::Running, T::Waiting, 7));
        assert_eq!(told(running.0, running.1, false), (P::Stopped, T::Dormant, 7));
        // What has faulted has done so before the end.
        let faulted = (ProgramState::Faulted, TaskState::Faulted);
        assert_eq!(told(faulted.0, faulted.1, false), (P::Faulted, T::Faulted, 7));
    }
}
