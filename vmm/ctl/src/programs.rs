//! Programs with their versions and tasks as rows of tables, and what is forced.

use takt_protocol::{
    ImageVersion, PartitionStatus, ProgramState, ProgramStatus, TaskState, TaskStatus,
    VersionStatus,
};

use crate::text::plain;

/// Titles of that table.
pub const COLUMNS: [&str; 8] =
    ["task", "state", "jobs", "missed", "overruns", "longest", "response", "slack"];

/// The tasks of a partition; a program of which no task is known yet is a row as well.
pub fn rows(partition: &PartitionStatus) -> Vec<[String; 8]> {
    let of = |program: &ProgramStatus| -> Vec<[String; 8]> {
        let name = format!("{}:{}", partition.name, program.name);
        if program.tasks.is_empty() {
            let none = || "-".to_owned();
            let state = state(program).to_owned();
            return vec![[plain(&name), state, none(), none(), none(), none(), none(), none()]];
        }
        program.tasks.iter().map(|task| row(&name, program, task)).collect()
    };
    partition.programs.iter().flat_map(of).collect()
}

fn row(name: &str, program: &ProgramStatus, task: &TaskStatus) -> [String; 8] {
    let state = match (program.state, task.state) {
        (Some(ProgramState::Running), TaskState::Dormant) => "dormant",
        (Some(ProgramState::Running), TaskState::Waiting) => "waiting",
        (Some(ProgramState::Running), TaskState::Ready) => "ready",
        (_, TaskState::Faulted) => "faulted",
        _ => state(program),
    };
    let time = |ns: u64| format!("{:.1} us", ns as f64 / 1e3);
    [
        plain(&format!("{name}.{}", task.name)),
        state.to_owned(),
        task.jobs.to_string(),
        task.missed.to_string(),
        task.overruns.to_string(),
        time(task.execution_max_ns),
        time(task.response_max_ns),
        task.slack_min_ns.map_or("-".to_owned(), time),
    ]
}

fn state(program: &ProgramStatus) -> &'static str {
    match program.state {
        None => "?",
        Some(ProgramState::Stopped) => "stopped",
        Some(ProgramState::Starting) => "starting",
        Some(ProgramState::Running) => "running",
        Some(ProgramState::Faulted) => "faulted",
    }
}

/// Titles of the table of versions.
pub const VERSION_COLUMNS: [&str; 4] = ["program", "runs", "other", "change"];

/// The version of a program, and how far a change is.
pub fn version_row(partition: &str, status: &VersionStatus) -> [String; 4] {
    let image = |image: &ImageVersion| {
        let digits: String = image.hash.chars().take(8).collect();
        plain(&format!("{} ({digits})", image.version))
    };
    let change = match (status.phase.as_str(), &status.reason) {
        ("none", None) => "-".to_owned(),
        ("trial", _) => format!("trial, {} jobs", status.jobs),
        (phase, Some(reason)) => format!("{phase}: {reason}"),
        (phase, None) => phase.to_owned(),
    };
    [
        plain(&format!("{partition}:{}", status.program)),
        image(&status.running),
        status.other.as_ref().map_or("-".to_owned(), image),
        plain(&change),
    ]
}

/// A line for each value that is forced.
pub fn forced(partition: &PartitionStatus) -> Vec<String> {
    let line = |forced: &takt_protocol::ForcedStatus| {
        let since = forced.since_ns as f64 / 1e9;
        let (name, text) = (&forced.name, &forced.text);
        plain(&format!("{}: FORCED {name} = {text}, since {since:.3} s", partition.name))
    };
    partition.forced.iter().map(line).collect()
}
