//! What a task is: an entry of a program, a rule for its releases, a priority and limits.
//!
//! One release leads to one *job*. The states are those of ARINC 653 processes, of which a task is one:
//!
//! | state here | process state | the task |
//! | --- | --- | --- |
//! | [`State::Dormant`] | DORMANT | its program does not run, or has not started yet |
//! | [`State::Waiting`] | WAITING | waits for its next release, or in a call, always with a time-out |
//! | [`State::Ready`] | READY | has a job to do, and a more urgent one has the processor |
//! | `Ready`, and chosen by the scheduler | RUNNING | has the processor |
//! | [`State::Faulted`] | FAULTED | has stopped its program by an error |

use crate::scheduler::TASKS_MAX;
use crate::statistics::Statistics;
use crate::time::{Instant, Span};
use crate::watchdog::Watchdog;

/// Place of a task in the [scheduler](crate::scheduler::Scheduler).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TaskId(pub u8);

/// Place of a program there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProgramId(pub u8);

impl TaskId {
    /// As an index. That it is one of a table of [`TASKS_MAX`] is said so that no access has to look.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize % TASKS_MAX
    }

    /// Its bit in a set of tasks by their places.
    pub(crate) const fn bit(self) -> u64 {
        1 << self.0
    }
}

impl ProgramId {
    /// As an index.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// When the jobs of a task are released.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Release {
    /// Once, when its program starts: the program's initialisation. When it ends, the others begin.
    Start,
    /// At `offset + k * period`.
    Cyclic {
        /// From one release to the next; not zero.
        period: Span,
        /// Of the first release, after the beginning of time.
        offset: Span,
    },
    /// When something happens, but not sooner than this after the release before. Events between two
    /// releases lead to one job.
    Event {
        /// From one release to the next, at least.
        minimum: Span,
    },
    /// Once in each window, if the window has time left for it.
    Freewheeling,
}

/// What a task is from the start on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Settings {
    /// The program whose entry it is.
    pub program: ProgramId,
    /// When it is released.
    pub release: Release,
    /// 0 is the most urgent.
    pub priority: u8,
    /// Time from a release to the latest end of its job; zero: no limit.
    pub deadline: Span,
    /// Execution time that a job may use; zero: no limit.
    pub budget: Span,
    /// See [`watchdog`](crate::watchdog).
    pub sensitivity: u16,
}

impl Settings {
    /// Its priority among the tasks of the first [class](Class); of one of another class the least, since it comes after all of
    /// those whatever its priority.
    pub(crate) const fn urgency(&self) -> u8 {
        match self.release {
            Release::Cyclic { .. } | Release::Event { .. } => self.priority,
            Release::Freewheeling | Release::Start => u8::MAX,
        }
    }
}

/// What precedes the priority in a task's rank: the analysis of the tasks reckons only with those of the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// It is released at most so often; or it is freewheeling, has a budget and holds a semaphore that such a task may want.
    Bounded,
    /// It takes what the others leave.
    Freewheeling,
    /// The initialisation of a program, which has no budget and may never end. They share what is left with each other, and with
    /// the most urgent freewheeling task: the one whose job has executed the least comes first.
    Initialisation,
}

/// What a task waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Wait {
    /// Its next release.
    Release,
    /// A message in the queue with this place.
    Message(u8),
    /// Flags of the object with this place.
    Flags {
        /// Place of the object.
        object: u8,
        /// The flags that matter.
        mask: u32,
        /// All of them, or any.
        all: bool,
    },
}

/// See the [module](self).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Nothing to do, and no release is coming.
    Dormant,
    /// Something has to happen first.
    Waiting(Wait),
    /// It could run.
    Ready,
    /// It has stopped its program.
    Faulted,
}

/// How a wait in a call ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Wake {
    /// Its time was up.
    TimedOut,
    /// A message was handed over.
    Message,
    /// The flags at that moment.
    Flags(u32),
}

/// A task.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Task {
    pub(crate) settings: Settings,
    /// Its place among all tasks, the most urgent first.
    pub(crate) rank: u8,
    pub(crate) watchdog: Watchdog,
    pub(crate) state: State,
    /// Its [urgency](Settings::urgency), or the ceiling of a semaphore that it holds if that is more urgent.
    pub(crate) effective: u8,
    /// Semaphores that it holds, a bit for each number in its program.
    pub(crate) held: u64,
    /// Release of the current job, or of the last one.
    pub(crate) released: Instant,
    /// Execution of the current job.
    pub(crate) executed: Span,
    /// The current job has run.
    pub(crate) started: bool,
    /// The last job was ended in the middle: what it writes may be half written.
    pub(crate) cut: bool,
    /// That its start has been measured.
    pub(crate) measured: bool,
    /// That the current job passed its deadline has been told.
    pub(crate) missed: bool,
    /// That the current job used up its budget has been told.
    pub(crate) exceeded: bool,
    /// Cyclic: the next release. Event: the earliest next release.
    pub(crate) next: Instant,
    /// Something has happened that the task has to look at.
    pub(crate) signalled: bool,
    /// End of a wait in a call.
    pub(crate) until: Instant,
    pub(crate) wake: Option<Wake>,
    /// Time between the current release and the one before.
    pub(crate) elapsed: Span,
    /// Jobs since the program's start.
    pub(crate) cycle: u64,
    pub(crate) statistics: Statistics,
}

impl Task {
    pub(crate) const fn new(settings: Settings) -> Self {
        Self {
            settings,
            rank: 0,
            watchdog: Watchdog::new(settings.budget, settings.sensitivity),
            state: State::Dormant,
            effective: settings.urgency(),
            held: 0,
            released: Instant(0),
            executed: Span::ZERO,
            started: false,
            cut: false,
            measured: false,
            missed: false,
            exceeded: false,
            next: Instant::NEVER,
            signalled: false,
            until: Instant::NEVER,
            wake: None,
            elapsed: Span::ZERO,
            cycle: 0,
            statistics: Statistics::NONE,
        }
    }

    /// What it is.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// In which state it is.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// Its figures.
    #[must_use]
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Its bit in a set of tasks by their ranks.
    pub(crate) const fn bit(&self) -> u64 {
        1 << self.rank
    }

    /// Execution of all its jobs, with the current one.
    #[must_use]
    pub const fn executed(&self) -> Span {
        self.statistics.executed.plus(self.executed)
    }

    /// Release of the current job.
    #[must_use]
    pub const fn released(&self) -> Instant {
        self.released
    }

    /// True if its jobs have an end, which the analysis of the tasks knows.
    #[must_use]
    #[inline]
    pub const fn is_bounded(&self) -> bool {
        matches!(self.class(), Class::Bounded)
    }

    /// True if its last job was ended in the middle: what it writes may be half written.
    #[must_use]
    pub const fn was_cut(&self) -> bool {
        self.cut
    }

    /// True if no job of it is there or to come: what it waits for has not happened since its last release.
    #[must_use]
    pub const fn awaits_event(&self) -> bool {
        matches!(self.state, State::Waiting(Wait::Release)) && !self.signalled
    }

    /// True if the current job has not kept a limit. The next one may be released the moment it ends.
    #[must_use]
    pub const fn has_violated(&self) -> bool {
        self.missed || self.exceeded
    }

    /// Time between that release and the one before; zero for the first.
    #[must_use]
    pub const fn elapsed(&self) -> Span {
        self.elapsed
    }

    /// Jobs since its program's start.
    #[must_use]
    pub const fn cycle(&self) -> u64 {
        self.cycle
    }

    /// True from a release to the end of its job.
    pub(crate) const fn is_active(&self) -> bool {
        !matches!(self.state, State::Dormant | State::Faulted | State::Waiting(Wait::Release))
    }

    pub(crate) const fn class(&self) -> Class {
        match self.settings.release {
            // No task that may want what it holds begins before it has ended.
            Release::Start => Class::Initialisation,
            _ if self.held != 0 => Class::Bounded,
            Release::Cyclic { .. } | Release::Event { .. } => Class::Bounded,
            Release::Freewheeling => Class::Freewheeling,
        }
    }

    /// Its place within its class, the smallest first.
    pub(crate) const fn urgency(&self) -> u64 {
        match self.class() {
            Class::Initialisation => self.executed.0,
            Class::Bounded | Class::Freewheeling => self.effective as u64,
        }
    }

    /// Latest end of the current job.
    pub(crate) const fn due(&self) -> Instant {
        match self.settings.deadline {
            Span::ZERO => Instant::NEVER,
            deadline => self.released.after(deadline),
        }
    }

    /// When time alone will change something about it.
    pub(crate) fn event(&self) -> Instant {
        let release = match (self.state, self.settings.release) {
            (State::Dormant | State::Faulted, _) => return Instant::NEVER,
            (_, Release::Cyclic { .. }) => self.next,
            (State::Waiting(Wait::Release), Release::Event { .. }) if self.signalled => self.next,
            _ => Instant::NEVER,
        };
        let due = if self.is_active() && !self.missed { self.due() } else { Instant::NEVER };
        let until = match self.state {
            State::Waiting(Wait::Message(_) | Wait::Flags { .. }) => self.until,
            _ => Instant::NEVER,
        };
        release.min(due).min(until)
    }

    /// Passes over the releases up to `now`. Returns the last of them, and how many there were.
    pub(crate) fn pass(&mut self, now: Instant) -> Option<(Instant, u64)> {
        let Release::Cyclic { period, .. } = self.settings.release else {
            return None;
        };
        if self.next > now || self.next == Instant::NEVER {
            return None;
        }
        let more = now.since(self.next).0.checked_div(period.0)?;
        let last = self.next.after(period.times(more));
        self.next = last.after(period);
        Some((last, more.saturating_add(1)))
    }

    /// A job begins.
    pub(crate) fn release(&mut self, at: Instant) {
        self.elapsed = if self.cycle == 0 { Span::ZERO } else { at.since(self.released) };
        self.released = at;
        self.statistics.executed = self.executed();
        self.executed = Span::ZERO;
        self.started = false;
        self.measured = false;
        self.missed = false;
        self.exceeded = false;
        self.state = State::Ready;
    }

    /// The current job is over. What it held has been given back.
    pub(crate) fn retire(&mut self) {
        self.wake = None;
        self.state = match self.settings.release {
            Release::Start => State::Dormant,
            _ => State::Waiting(Wait::Release),
        };
        self.cycle += 1;
    }
}
