//! The schedule, tick by tick, in the dullest way: no arithmetic on periods, no jumps, nothing
//! taken from the code under test. A tick is a microsecond.

/// One job of a task.
#[derive(Clone, Copy, Debug)]
pub struct Job {
    /// The task, and its priority.
    pub task: usize,
    pub priority: u8,
    /// Ticks since the epoch.
    pub release: u64,
    pub deadline: u64,
    /// Ticks that it executes.
    pub work: u64,
}

/// The first job that was not complete at its deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Miss {
    pub task: usize,
    pub release: u64,
    pub deadline: u64,
    pub undone: u64,
}

/// Which ticks of a frame belong to the tasks. `windows` are `start..end` in ticks.
pub fn open_ticks(frame: u64, windows: &[(u64, u64)], overhead: u64) -> Vec<bool> {
    let open = |tick| windows.iter().any(|&(start, end)| start + overhead <= tick && tick < end);
    (0..frame).map(open).collect()
}

/// Runs all jobs, for ever if need be; the longest response of each task, or the first miss.
pub fn simulate(open: &[bool], tasks: usize, jobs: &[Job]) -> Result<Vec<u64>, Miss> {
    let mut responses = vec![0; tasks];
    let mut waiting: Vec<Job> = jobs.to_vec();
    waiting.sort_by_key(|job| std::cmp::Reverse(job.release));
    let mut pending: Vec<Job> = Vec::new();
    let mut tick = 0;
    while !(waiting.is_empty() && pending.is_empty()) {
        let late = pending.iter().filter(|job| job.deadline == tick);
        if let Some(&Job { task, release, deadline, work, .. }) = late.max_by_key(|j| j.priority) {
            return Err(Miss { task, release, deadline, undone: work });
        }
        while waiting.last().is_some_and(|job| job.release == tick) {
            pending.extend(waiting.pop());
        }
        let urgency = |&i: &usize| (pending[i].priority, std::cmp::Reverse(pending[i].release));
        if open[(tick % open.len() as u64) as usize]
            && let Some(next) = (0..pending.len()).max_by_key(urgency)
        {
            pending[next].work -= 1;
            if pending[next].work == 0 {
                let job = pending.swap_remove(next);
                responses[job.task] = responses[job.task].max(tick + 1 - job.release);
            }
        }
        tick += 1;
    }
    Ok(responses)
}
