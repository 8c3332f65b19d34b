//! What a status tells that never changes in a run.

use std::process;

use takt_scheduler::table::{Role, Table};
use takt_scheduler::time::Nanos;

use super::protocol::WindowStatus;
use crate::config::{Kind, PartitionFile, Program};

/// Most windows that a status lists: a frame can have thousands, and a screen has no use for them.
pub const WINDOWS_MAX: usize = 64;

/// From the partition file.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Of this process.
    pub(super) pid: u32,
    /// Name of the system.
    pub(super) system: String,
    /// The partition file.
    pub(super) file: String,
    /// Length of the major frame.
    pub(super) frame: Nanos,
    /// By [`takt_scheduler::schedules::ScheduleId`].
    pub(super) schedules: Vec<Windows>,
    /// By position in the file.
    pub(super) partitions: Vec<PartitionFacts>,
}

/// The windows of a schedule, as far as they are listed.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    pub name: String,
    pub listed: Vec<WindowStatus>,
    pub left_out: u64,
}

/// What never changes of a partition.
#[derive(Clone, Debug)]
pub(super) struct PartitionFacts {
    pub kind: &'static str,
    pub cpu: u64,
    pub background: bool,
    /// Its programs, in the order of the file.
    pub programs: Vec<ProgramFacts>,
}

/// What never changes of a program.
#[derive(Clone, Debug)]
pub(super) struct ProgramFacts {
    pub name: String,
    /// By their numbers in the image.
    pub tasks: Vec<String>,
}

impl Facts {
    /// Of this file.
    #[must_use]
    pub fn new(file: &PartitionFile) -> Facts {
        let windows = |(name, table): (&String, &Table)| {
            let all = table.cpus().into_iter().flat_map(|cpu| table.windows_on(cpu));
            let mut listed: Vec<WindowStatus> = all
                .map(|window| WindowStatus {
                    partition: file.partitions()[window.partition.0].name().to_owned(),
                    offset_ns: window.offset.0,
                    duration_ns: window.duration.0,
                })
                .collect();
            let left_out = listed.len().saturating_sub(WINDOWS_MAX) as u64;
            listed.truncate(WINDOWS_MAX);
            Windows { name: name.clone(), listed, left_out }
        };
        let placements = file.schedules().placements();
        Facts {
            pid: process::id(),
            system: file.name().to_owned(),
            file: file.path().display().to_string(),
            frame: file.schedules().frame(),
            schedules: file
                .schedule_names()
                .iter()
                .zip(file.schedules().tables())
                .map(windows)
                .collect(),
            partitions: file
                .partitions()
                .iter()
                .map(|partition| PartitionFacts {
                    kind: match partition.kind() {
                        Kind::Plc { .. } => "plc",
                        Kind::Linux { .. } => "linux",
                    },
                    cpu: partition.cpu().0 as u64,
                    background: placements[partition.id().0].role == Role::Background,
                    programs: partition.programs().iter().map(ProgramFacts::new).collect(),
                })
                .collect(),
        }
    }
}

impl ProgramFacts {
    fn new(program: &Program) -> Self {
        let image = program.image();
        let tasks = image.iter().flat_map(|image| image.tasks());
        Self { name: program.name.clone(), tasks: tasks.map(|task| task.name.to_owned()).collect() }
    }
}
