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

/// The same of many frames, each window of which also loses `interrupts` ticks in one place, wherever that hurts. For each
/// window one of `places` chooses it: half of them choose a release inside of the window, if there is one.
pub fn disturbed_ticks(
    open: &[bool],
    (frames, windows): (u64, &[(u64, u64)]),
    interrupts: u64,
    releases: &[u64],
    places: &[u64],
) -> Vec<bool> {
    let frame = open.len() as u64;
    let mut ticks = open.repeat(frames as usize);
    let mut places = places.iter().cycle();
    for (number, (start, end)) in (0..frames).flat_map(|n| windows.iter().map(move |w| (n, *w))) {
        let window = number * frame + start..number * frame + end;
        let inside: Vec<u64> = releases.iter().copied().filter(|r| window.contains(r)).collect();
        let place = places.next().copied().unwrap_or(0);
        let first = match place % 2 == 0 && !inside.is_empty() {
            true => inside[(place / 2) as usize % inside.len()],
            false => window.start + place / 2 % (end - start),
        };
        let lost = (first..window.end).filter(|tick| open[(tick % frame) as usize]);
        for tick in lost.take(interrupts as usize) {
            ticks[tick as usize] = false;
        }
    }
    ticks
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
