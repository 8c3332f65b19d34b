//! Who makes a call, as the kernel sees it (`objects.rs` and `task.rs` there).

use takt_program::{Task, TaskId, TaskKind};

/// A task. None is the initialisation, which is a task of its own.
pub type Who = Option<TaskId>;

/// The urgency of what comes after all cyclic tasks and event tasks, whatever its priority.
const LEAST_URGENT: u8 = u8::MAX;

/// Who calls, and when.
pub struct Caller {
    pub who: Who,
    /// What the ceilings of semaphores are compared with.
    pub urgency: u8,
    /// Nothing ends its job, so it may take no semaphore.
    pub is_endless: bool,
    pub now: u64,
}

impl Caller {
    /// A job of a task.
    pub fn task(task: &Task<'_>, now: u64) -> Self {
        let is_freewheeling = task.kind == TaskKind::Freewheeling;
        let urgency = if is_freewheeling { LEAST_URGENT } else { task.priority };
        let is_endless = is_freewheeling && task.budget.is_none();
        Self { who: Some(task.id), urgency, is_endless, now }
    }

    /// The initialisation.
    pub const fn init(now: u64) -> Self {
        Self { who: None, urgency: LEAST_URGENT, is_endless: false, now }
    }
}
