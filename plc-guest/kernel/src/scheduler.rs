//! The life of tasks and programs: releases, limits, ends, starts and stops.
//!
//! The kernel calls this at each of its entries, with the time that it is then: [`Scheduler::account`]
//! for what has run, [`Scheduler::advance`] for what time alone changes, what the running task asked for, and
//! [`Scheduler::pick`] for what runs next ([`rank`](crate::rank)). Each takes a number of steps that depends on the number of
//! tasks only.
//!
//! Releases are kept as `offset + k * period` and never reckoned from now, so a late one moves no later
//! one. A release that finds the job before it unfinished is lost and counted; it is not made up.

use crate::objects::{Object, ObjectId};
use crate::statistics::count;
use crate::task::{ProgramId, Release, Settings, State, Task, TaskId, Wait, Wake};
use crate::time::{Instant, Span};
use crate::watchdog::Watchdog;
use core::ops::Range;

/// Most tasks of a scheduler, with the start of each program: a set of them is one word.
pub const TASKS_MAX: usize = 64;
/// Most objects. Those of one program are a set in one word too.
pub const OBJECTS_MAX: usize = 255;
/// Most objects of one program.
pub const OBJECTS_EACH_MAX: u8 = 64;

/// Where a program is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// None of its tasks runs.
    Stopped,
    /// It is initialised.
    Starting,
    /// Its tasks are released.
    Running,
}

/// A program.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Program {
    pub(crate) phase: Phase,
    /// Places of its objects.
    pub(crate) objects: Range<u8>,
}

/// A limit that a job did not keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Violation {
    /// It used up its budget.
    Budget,
    /// It was not complete at its deadline.
    Deadline,
}

/// There is no room for one more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// The state of at most `T` tasks, `P` programs and `O` objects.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Scheduler<const T: usize, const P: usize, const O: usize> {
    pub(crate) tasks: [Task; T],
    pub(crate) tasks_count: u8,
    pub(crate) programs: [Program; P],
    pub(crate) programs_count: u8,
    pub(crate) objects: [Object; O],
    pub(crate) objects_count: u8,
    /// All tasks by rank, the most urgent first.
    pub(crate) order: [TaskId; T],
    /// Tasks in state ready, a bit for each rank.
    pub(crate) ready: u64,
    /// Tasks that wait in a call, a bit for each rank.
    pub(crate) in_call: u64,
    /// Tasks whose place among the ready ones is not their rank, a bit for each: holders of semaphores, initialisations.
    pub(crate) out_of_rank: u64,
    pub(crate) running: Option<TaskId>,
    /// Who had the processor last; at first a task that there is not.
    pub(crate) last: TaskId,
    /// Before this instant time alone changes nothing.
    pub(crate) next: Instant,
    /// Tasks whose deadline has passed, a bit for each.
    late: u64,
}

const NO_TASK: Task = Task::new(Settings {
    program: ProgramId(0),
    release: Release::Start,
    priority: 255,
    deadline: Span::ZERO,
    budget: Span::ZERO,
    sensitivity: 0,
});

impl<const T: usize, const P: usize, const O: usize> Scheduler<T, P, O> {
    /// Without tasks.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(T <= TASKS_MAX && P <= 64 && O <= OBJECTS_MAX) };
        Self {
            tasks: [NO_TASK; T],
            tasks_count: 0,
            programs: [const { Program { phase: Phase::Stopped, objects: 0..0 } }; P],
            programs_count: 0,
            objects: [Object::Flags(0); O],
            objects_count: 0,
            order: [TaskId(0); T],
            ready: 0,
            in_call: 0,
            out_of_rank: 0,
            running: None,
            last: TaskId(u8::MAX),
            next: Instant::NEVER,
            late: 0,
        }
    }

    /// Gives a task, which has no job, deadline, budget and sensitivity of another version. All else stays as it was.
    pub fn set_limits(&mut self, id: TaskId, of: &Settings) {
        let task = &mut self.tasks[id.index()];
        let Settings { deadline, budget, sensitivity, .. } = *of;
        let limits = Settings { deadline, budget, sensitivity, ..task.settings };
        if limits != task.settings {
            task.settings = limits;
            task.watchdog = Watchdog::new(budget, sensitivity);
        }
    }

    /// Adds a program, with these objects.
    ///
    /// # Errors
    /// [`Full`]; nothing is added then.
    pub fn add_program(
        &mut self,
        objects: impl Iterator<Item = Object>,
    ) -> Result<ProgramId, Full> {
        let id = self.programs_count;
        let program = self.programs.get_mut(usize::from(id)).ok_or(Full)?;
        let start = self.objects_count;
        let mut end = start;
        for object in objects {
            if end - start == OBJECTS_EACH_MAX {
                return Err(Full);
            }
            *self.objects.get_mut(usize::from(end)).ok_or(Full)? = object.fresh();
            end += 1;
        }
        program.objects = start..end;
        self.objects_count = end;
        self.programs_count += 1;
        Ok(ProgramId(id))
    }

    /// Adds a task, to a program that there is, before any is started.
    ///
    /// # Errors
    /// [`Full`].
    pub fn add_task(&mut self, settings: Settings) -> Result<TaskId, Full> {
        let (id, count) = (TaskId(self.tasks_count), usize::from(self.tasks_count));
        *self.tasks.get_mut(id.index()).ok_or(Full)? = Task::new(settings);
        self.tasks_count += 1;
        let key = |id: TaskId| {
            let task = &self.tasks[id.index()];
            (task.class(), task.settings.priority)
        };
        let place = self.order[..count].partition_point(|other| key(*other) <= key(id));
        self.order[count] = id;
        self.order[place..=count].rotate_right(1);
        for (rank, id) in self.order[..=count].iter().enumerate() {
            self.tasks[id.index()].rank = rank as u8;
        }
        let initialisations = self.tasks.iter().take(count + 1);
        let initialisations = initialisations.filter(|t| t.settings.release == Release::Start);
        self.out_of_rank = initialisations.fold(0, |set, task| set | task.bit());
        Ok(id)
    }

    /// All tasks.
    pub fn ids(&self) -> impl Iterator<Item = TaskId> + use<T, P, O> {
        (0..self.tasks_count).map(TaskId)
    }

    /// All programs.
    pub fn programs(&self) -> impl Iterator<Item = ProgramId> + use<T, P, O> {
        (0..self.programs_count).map(ProgramId)
    }

    /// A task that [`ids`](Self::ids) knows.
    #[must_use]
    pub const fn task(&self, id: TaskId) -> &Task {
        &self.tasks[id.index()]
    }

    /// Where a program is in its life.
    #[must_use]
    pub const fn phase(&self, program: ProgramId) -> Phase {
        self.programs[program.index()].phase
    }

    /// An object that [`object_of`](Self::object_of) knows.
    #[must_use]
    pub const fn object_at(&self, id: ObjectId) -> Object {
        self.objects[id.0 as usize]
    }

    /// Who has the processor.
    #[must_use]
    pub const fn running(&self) -> Option<TaskId> {
        self.running
    }

    /// Times that another task than the one before was given the processor.
    #[must_use]
    pub fn switches(&self) -> u64 {
        self.tasks.iter().fold(0, |sum, task| sum + task.statistics.switches)
    }

    /// The next instant at which time alone changes something.
    #[must_use]
    pub const fn next_event(&self) -> Instant {
        self.next
    }

    /// The same, without what was expected of jobs that are over: their deadlines, and the time-outs of waits that ended earlier.
    pub fn look_ahead(&mut self) -> Instant {
        self.next = Instant::NEVER;
        self.ids().for_each(|id| self.expect(id));
        self.next
    }

    /// True if the program runs and none of its tasks has a job: no task uses its state until the next release.
    #[must_use]
    pub fn is_between_jobs(&self, program: ProgramId) -> bool {
        self.phase(program) == Phase::Running
            && self.tasks_of(program).all(|id| !self.tasks[id.index()].is_active())
    }

    /// Ends all jobs of a program without their doing. Its tasks go on with their next releases.
    pub fn abandon(&mut self, program: ProgramId, now: Instant) {
        for id in self.tasks_of(program) {
            self.skip(id, now);
        }
    }

    /// Starts a stopped program: its initialisation is released. A program without one runs at once.
    pub fn start(&mut self, program: ProgramId, now: Instant) {
        self.stop(program);
        self.lower_ceilings(program);
        self.programs[program.index()].phase = Phase::Starting;
        let mut starting = false;
        for id in self.tasks_of(program) {
            let task = &mut self.tasks[id.index()];
            task.cycle = 0;
            task.cut = false;
            task.watchdog.forget();
            if task.settings.release == Release::Start {
                self.release(id, now);
                starting = true;
            }
        }
        if !starting {
            self.run(program, now);
        }
    }

    /// No semaphore raises a task above the most urgent one of its program: none of them could want it, and other programs'
    /// tasks would wait.
    fn lower_ceilings(&mut self, program: ProgramId) {
        let urgencies = self.tasks_of(program).map(|id| self.tasks[id.index()].settings.urgency());
        let most_urgent = urgencies.min().unwrap_or(u8::MAX);
        let Range { start, end } = self.programs[program.index()].objects;
        for object in &mut self.objects[usize::from(start)..usize::from(end)] {
            if let Object::Semaphore { ceiling, .. } = object {
                *ceiling = (*ceiling).max(most_urgent);
            }
        }
    }

    /// The tasks of a program wait for their releases from now on.
    fn run(&mut self, program: ProgramId, now: Instant) {
        self.programs[program.index()].phase = Phase::Running;
        for id in self.tasks_of(program) {
            let task = &mut self.tasks[id.index()];
            task.next = match task.settings.release {
                Release::Start => continue,
                Release::Cyclic { period, offset } => {
                    let past = now.since(Instant(0)).0.saturating_sub(offset.0);
                    let periods = past.div_ceil(period.0.max(1));
                    Instant(offset.0).after(period.times(periods))
                }
                Release::Event { .. } | Release::Freewheeling => now,
            };
            task.state = State::Waiting(Wait::Release);
            task.signalled = false;
            self.expect(id);
        }
    }

    /// Stops a program: none of its tasks runs any more, and its objects are as at the start.
    pub fn stop(&mut self, program: ProgramId) {
        for id in self.tasks_of(program) {
            self.give_all(id);
            let task = &mut self.tasks[id.index()];
            // The one that runs has chosen this instant, or has failed.
            task.cut |= task.started && task.is_active() && self.running != Some(id);
            task.state = State::Dormant;
            task.wake = None;
            self.ready &= !task.bit();
            self.in_call &= !task.bit();
            self.late &= !id.bit();
            if self.running == Some(id) {
                self.running = None;
            }
        }
        let program = &mut self.programs[program.index()];
        program.phase = Phase::Stopped;
        let objects = usize::from(program.objects.start)..usize::from(program.objects.end);
        for object in &mut self.objects[objects] {
            *object = object.fresh();
        }
    }

    /// Stops the program of a task that has failed.
    pub fn fail(&mut self, id: TaskId) {
        self.stop(self.tasks[id.index()].settings.program);
        self.tasks[id.index()].state = State::Faulted;
    }

    /// A task, which was running, has executed for so long. Tells if that is more than it may, once a job.
    #[inline]
    pub fn account(&mut self, id: TaskId, ran: Span) -> Option<Violation> {
        let task = &mut self.tasks[id.index()];
        task.executed.0 = task.executed.0.wrapping_add(ran.0);
        if !task.watchdog.expired(task.executed) || task.exceeded {
            return None;
        }
        task.exceeded = true;
        count(&mut task.statistics.over_budget, 1);
        Some(Violation::Budget)
    }

    /// Does what is due: releases, time-outs, deadlines.
    #[inline]
    pub fn advance(&mut self, now: Instant) {
        if now >= self.next {
            self.advance_all(now);
        }
    }

    fn advance_all(&mut self, now: Instant) {
        self.next = Instant::NEVER;
        for id in self.ids() {
            self.advance_task(id, now);
            self.expect(id);
        }
    }

    fn advance_task(&mut self, id: TaskId, now: Instant) {
        let task = &mut self.tasks[id.index()];
        match task.state {
            State::Dormant | State::Faulted => return,
            State::Waiting(Wait::Release) => match task.settings.release {
                Release::Cyclic { .. } => {
                    if let Some((last, passed)) = task.pass(now) {
                        count(&mut task.statistics.overruns, passed - 1);
                        self.release(id, last);
                    }
                }
                Release::Event { .. } if task.signalled && task.next <= now => {
                    self.release_event(id, now);
                }
                _ => {}
            },
            State::Waiting(_) if task.until <= now => self.wake(id, Wake::TimedOut),
            State::Waiting(_) | State::Ready => {}
        }
        let task = &mut self.tasks[id.index()];
        if !task.is_active() {
            return;
        }
        if let Some((_, passed)) = task.pass(now) {
            count(&mut task.statistics.overruns, passed);
        }
        if !task.missed && task.due() < now {
            task.missed = true;
            count(&mut task.statistics.misses, 1);
            self.late |= id.bit();
        }
    }

    /// A task whose job has passed its deadline, each told once.
    pub fn take_late(&mut self) -> Option<TaskId> {
        if self.late == 0 {
            return None;
        }
        let id = TaskId(self.late.trailing_zeros() as u8);
        self.late &= !id.bit();
        Some(id)
    }

    /// What an event task waits for has happened. If it happens again before a job is released for it, it is one release,
    /// and the other is lost and counted.
    pub fn signal(&mut self, id: TaskId, now: Instant) {
        let task = &mut self.tasks[id.index()];
        if matches!(task.state, State::Dormant | State::Faulted) {
            return;
        }
        if core::mem::replace(&mut task.signalled, true) {
            count(&mut task.statistics.overruns, 1);
        }
        self.look_at_signal(id, now);
    }

    /// What an event task waits for is there, and perhaps it was before: a message stays in its queue until it is received.
    /// A release that has come of it already, or is to come, is enough; what is left then leads to the next.
    pub fn signal_again(&mut self, id: TaskId, now: Instant) {
        if self.task(id).awaits_event() {
            self.signal(id, now);
        }
    }

    fn release_event(&mut self, id: TaskId, now: Instant) {
        let task = &mut self.tasks[id.index()];
        if let Release::Event { minimum } = task.settings.release {
            task.signalled = false;
            task.next = now.after(minimum);
            self.release(id, now);
        }
    }

    /// A window begins: each freewheeling task has a job, if it has done the last.
    pub fn window(&mut self, now: Instant) {
        for id in self.ids() {
            let task = &self.tasks[id.index()];
            let waits = task.state == State::Waiting(Wait::Release);
            if waits && task.settings.release == Release::Freewheeling {
                self.release(id, now);
            }
        }
    }

    fn release(&mut self, id: TaskId, at: Instant) {
        let task = &mut self.tasks[id.index()];
        task.release(at);
        self.ready |= task.bit();
        self.expect(id);
    }

    /// Ends a wait in a call.
    pub(crate) fn wake(&mut self, id: TaskId, wake: Wake) {
        let task = &mut self.tasks[id.index()];
        task.wake = Some(wake);
        task.state = State::Ready;
        self.ready |= task.bit();
        self.in_call &= !task.bit();
    }

    /// Notes when time will change something about a task.
    pub(crate) fn expect(&mut self, id: TaskId) {
        self.next = self.next.min(self.tasks[id.index()].event());
    }

    /// A task that has been picked gets the processor at this instant, for the first time in its job.
    #[inline]
    pub fn begins(&mut self, id: TaskId, now: Instant) {
        let task = &mut self.tasks[id.index()];
        task.measured = true;
        let waited = now.since(task.released);
        task.statistics.start_max = task.statistics.start_max.max(waited);
    }

    /// The running task's job is complete. Tells if it was one too many over its budget.
    #[inline(always)]
    pub fn end(&mut self, now: Instant) -> Option<Violation> {
        let id = self.running.take()?;
        self.give_all(id);
        let task = &mut self.tasks[id.index()];
        let (executed, response) = (task.executed, now.since(task.released));
        let deadline = task.settings.deadline;
        task.statistics.ended(executed, response);
        if deadline != Span::ZERO {
            let slack = Span(deadline.0.saturating_sub(response.0));
            task.statistics.slack_min = task.statistics.slack_min.min(slack);
            if response > deadline && !task.missed {
                count(&mut task.statistics.misses, 1);
                self.late |= id.bit();
            }
        }
        let mut violation = None;
        if task.watchdog.is_to_see(executed) {
            if !task.exceeded && task.watchdog.exceeds(executed) {
                count(&mut task.statistics.over_budget, 1);
            }
            violation =
                (task.watchdog.ended(executed) && !task.exceeded).then_some(Violation::Budget);
        }
        let starting = (task.settings.release == Release::Start).then_some(task.settings.program);
        task.cut = false;
        self.retire(id, now);
        if let Some(program) = starting {
            self.run(program, now);
        }
        violation
    }

    /// Ends the job of a task without its doing.
    pub fn skip(&mut self, id: TaskId, now: Instant) {
        if !self.tasks[id.index()].is_active() {
            return;
        }
        self.give_all(id);
        let task = &mut self.tasks[id.index()];
        // One that waits for an event may have no other job for months.
        task.cut |= task.started && matches!(task.settings.release, Release::Cyclic { .. });
        count(&mut task.statistics.skipped, 1);
        if self.running == Some(id) {
            self.running = None;
        }
        self.in_call &= !self.tasks[id.index()].bit();
        self.retire(id, now);
    }

    #[inline]
    fn retire(&mut self, id: TaskId, now: Instant) {
        let task = &mut self.tasks[id.index()];
        self.ready &= !task.bit();
        task.retire();
        // The next release of a cyclic task has been expected since the last.
        if task.signalled {
            self.look_at_signal(id, now);
        }
    }

    /// An event task without a job has been signalled.
    #[inline(never)]
    fn look_at_signal(&mut self, id: TaskId, now: Instant) {
        let task = &self.tasks[id.index()];
        if task.next <= now && task.state == State::Waiting(Wait::Release) {
            self.release_event(id, now);
        } else {
            self.expect(id);
        }
    }

    fn tasks_of(&self, program: ProgramId) -> impl Iterator<Item = TaskId> + use<T, P, O> {
        let set = self.ids().fold(0u64, |set, id| {
            let own = self.tasks[id.index()].settings.program == program;
            set | if own { id.bit() } else { 0 }
        });
        self.ids().filter(move |id| set & id.bit() != 0)
    }
}

impl<const T: usize, const P: usize, const O: usize> Default for Scheduler<T, P, O> {
    fn default() -> Self {
        Self::new()
    }
}
