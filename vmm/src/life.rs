//! A partition's life: whether its guest runs, what is to become of it, and what follows from each event.
//!
//! A state machine without side effects: an event or an order goes in and effects come out, which
//! [`Account`](crate::account::Account) carries out. A vCPU's thread is never waited for. What is to end a guest is a
//! flag and a kick; the thread's word that its guest has left comes as at any other end, and the rest follows then.
//!
//! ```text
//!           stop, restart, HostFault           Left
//!   running ----------------------> halting -----------+
//!     ^  |                                             |
//!     |  +------------------- Left --------------+     |
//!     |                                          v     v
//!     +------------- a start follows ---------- the table below
//!     |                                                |
//!     |                                                | no start follows
//!     |                start, restart                  v
//!     +------------------------------------------ stopped, ended
//! ```
//!
//! | order before the guest left | health table, or change of schedule | what follows |
//! | --- | --- | --- |
//! | stop | any | stopped |
//! | restart | any | the operator's start; stopped, if there can be none |
//! | none | a start | that start; ended, if the run ends or nothing can load the guest |
//! | none | no start | ended |
//!
//! `shut-down` in the health table ends the run whatever else follows.

use takt_scheduler::time::{Nanos, Tsc};

use crate::boot::{Start, StartMode, StartReason};
use crate::control::protocol::State;
use crate::health::{Action, Detail};
use crate::vcpu::guest::End;

/// What a vCPU's thread leaves behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finished {
    /// Why it ended.
    pub end: End,
    /// When.
    pub at: Tsc,
    /// True if the guest had not scanned since its start; never for a guest without scans.
    pub starting: bool,
    /// Errors that were noted before.
    pub noted: u64,
    /// CPU time that it used.
    pub cpu_time: Nanos,
}

/// What an operator wants of a partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// To stop.
    Stop,
    /// To start, now that it has stopped or ended.
    Start(StartMode),
    /// To stop, if it runs, and to start again.
    Restart(StartMode),
}

/// Why an order is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// It makes no sense in this state.
    While(State),
    /// The guest retains nothing, so it has no warm start.
    NoWarmStart,
    /// There is no thread any more that could run the guest.
    Gone,
    /// Nothing is started any more.
    RunEnds,
}

/// Which starts a partition can have after its first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Starts {
    /// None: nothing can load its guest.
    None,
    /// Cold ones: its guest retains nothing.
    Cold,
    /// Cold and warm ones.
    ColdAndWarm,
}

/// What happens to a partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The host has an error with which the partition's table does not let its guest go on.
    HostFault(Detail),
    /// The thread tells that its guest has left.
    Left {
        /// What it tells, by way of [`Life::cause`].
        finished: Finished,
        /// What the health table says of this end; `None` if it is no error.
        action: Option<Action>,
        /// True if the guest was asked to switch itself off, since the run ends.
        leaving: bool,
    },
    /// The run is over, or ends and this guest is to be off by then: it is not started any more.
    RunOver,
}

/// What is to be done after an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effects {
    /// Take the thread out of its guest.
    pub halt: bool,
    /// What the thread was taken out for is done: it may enter its guest again.
    pub release: bool,
    /// Load the guest, and let its thread go on.
    pub load: Option<Start>,
    /// End the run.
    pub end_run: bool,
    /// Say what has become of the partition.
    pub told: Option<Told>,
}

/// What has become of a partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Told {
    /// It has ended.
    Ended,
    /// It has ended. It would have been started again if the run did not end.
    NotStarted,
    /// It has ended and is started again.
    Restarted,
    /// An order has been carried out, or could not be.
    Obeyed {
        /// The end that the guest came to by itself before it saw the order.
        instead: Option<End>,
        /// What has come of the order.
        result: Result<Order, Refused>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Its guest runs: halting if an order or an error of the host's waits for its end.
    Up { order: Option<Order>, fault: Option<Detail> },
    /// Its guest has ended.
    Down { finished: Finished, stopped: bool },
}

/// The life of one partition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Life {
    phase: Phase,
    starts: Starts,
    start_mode: StartMode,
    restarts: u64,
    ended_run: bool,
}

impl Life {
    const RUNNING: Phase = Phase::Up { order: None, fault: None };

    /// Of a partition that is about to start for the first time.
    #[must_use]
    pub const fn new(starts: Starts) -> Self {
        let start_mode = StartMode::Cold;
        Self { phase: Self::RUNNING, starts, start_mode, restarts: 0, ended_run: false }
    }

    /// What the partition is doing.
    #[must_use]
    pub const fn state(&self) -> State {
        match self.phase {
            Phase::Up { order: Some(Order::Stop), .. } => State::Stopping,
            Phase::Up { order: Some(_), .. } => State::Restarting,
            Phase::Up { order: None, .. } => State::Running,
            Phase::Down { stopped: true, .. } => State::Stopped,
            Phase::Down { stopped: false, .. } => State::Ended,
        }
    }

    /// True until its guest has ended and is not started again.
    #[must_use]
    pub const fn is_up(&self) -> bool {
        matches!(self.phase, Phase::Up { .. })
    }

    /// What its thread has left behind, once its guest has ended and is not started again.
    #[must_use]
    pub const fn finished(&self) -> Option<Finished> {
        match self.phase {
            Phase::Up { .. } => None,
            Phase::Down { finished, .. } => Some(finished),
        }
    }

    /// How its guest was started last.
    #[must_use]
    pub const fn start_mode(&self) -> StartMode {
        self.start_mode
    }

    /// How often its guest was started anew.
    #[must_use]
    pub const fn restarts(&self) -> u64 {
        self.restarts
    }

    /// True if an error of it has ended the run.
    #[must_use]
    pub const fn ended_run(&self) -> bool {
        self.ended_run
    }

    /// What its thread tells, with the error of the host's that was the reason, if one was. A guest that has ended
    /// by itself before keeps its own end.
    #[must_use]
    pub fn cause(&self, finished: Finished) -> Finished {
        match (self.phase, finished.end) {
            (Phase::Up { fault: Some(detail), .. }, End::Stopped) => {
                Finished { end: End::Raised(detail), ..finished }
            }
            _ => finished,
        }
    }

    /// Goes on by an event.
    #[must_use]
    pub fn step(&mut self, event: Event) -> Effects {
        match event {
            Event::HostFault(detail) => self.host_fault(detail),
            Event::Left { finished, action, leaving } => self.left(finished, action, leaving),
            Event::RunOver => {
                self.starts = Starts::None;
                if let Phase::Up { order, .. } = &mut self.phase {
                    *order = None;
                }
                Effects::default()
            }
        }
    }

    /// Goes on by an operator's order.
    ///
    /// # Errors
    /// If it is refused. Then nothing has changed.
    pub fn order(&mut self, order: Order) -> Result<Effects, Refused> {
        match (self.phase, order) {
            (Phase::Up { order: None, fault }, Order::Stop | Order::Restart(_)) => {
                if let Order::Restart(mode) = order {
                    self.may_start(mode)?;
                }
                self.phase = Phase::Up { order: Some(order), fault };
                Ok(Effects { halt: true, ..Effects::default() })
            }
            (Phase::Down { .. }, Order::Start(mode) | Order::Restart(mode)) => {
                self.may_start(mode)?;
                let told = Some(Told::Obeyed { instead: None, result: Ok(order) });
                Ok(Effects { told, ..self.start(mode, StartReason::Operator) })
            }
            _ => Err(Refused::While(self.state())),
        }
    }

    fn host_fault(&mut self, detail: Detail) -> Effects {
        let Phase::Up { fault, .. } = &mut self.phase else { return Effects::default() };
        *fault = Some(detail);
        Effects { halt: true, ..Effects::default() }
    }

    fn left(&mut self, finished: Finished, action: Option<Action>, leaving: bool) -> Effects {
        let Phase::Up { order, fault } = self.phase else { return Effects::default() };
        let release = order.is_some() || fault.is_some();
        let end_run = action == Some(Action::ShutDown);
        self.ended_run |= end_run;
        let effects = match order {
            Some(order) => self.obey(order, finished),
            None => self.follow(finished, action, leaving),
        };
        Effects { release, end_run, ..effects }
    }

    /// The guest has left after an order.
    fn obey(&mut self, order: Order, finished: Finished) -> Effects {
        self.phase = Phase::Down { finished, stopped: true };
        let (effects, result) = match order {
            Order::Stop => (Effects::default(), Ok(order)),
            Order::Start(mode) | Order::Restart(mode) => match self.may_start(mode) {
                Ok(()) => (self.start(mode, StartReason::Operator), Ok(order)),
                Err(refused) => (Effects::default(), Err(refused)),
            },
        };
        let instead = (finished.end != End::Stopped).then_some(finished.end);
        Effects { told: Some(Told::Obeyed { instead, result }), ..effects }
    }

    /// The guest has left without an order.
    fn follow(&mut self, finished: Finished, action: Option<Action>, leaving: bool) -> Effects {
        let start = match (finished.end, action) {
            (End::ScheduleChange(mode), _) => Some((mode, StartReason::ScheduleChange)),
            (_, Some(Action::ColdStart)) => Some((StartMode::Cold, StartReason::HealthMonitor)),
            (_, Some(Action::WarmStart)) => Some((StartMode::Warm, StartReason::HealthMonitor)),
            (_, None | Some(Action::Ignore | Action::Log | Action::Idle | Action::ShutDown)) => {
                None
            }
        };
        self.phase = Phase::Down { finished, stopped: false };
        match start {
            Some(_) if leaving => Effects { told: Some(Told::NotStarted), ..Effects::default() },
            Some((mode, reason)) if self.starts != Starts::None => {
                Effects { told: Some(Told::Restarted), ..self.start(mode, reason) }
            }
            _ => Effects { told: Some(Told::Ended), ..Effects::default() },
        }
    }

    fn start(&mut self, mode: StartMode, reason: StartReason) -> Effects {
        self.phase = Self::RUNNING;
        self.start_mode = mode;
        self.restarts += 1;
        Effects { load: Some(Start { mode, reason }), ..Effects::default() }
    }

    /// Whether an operator can have it started.
    fn may_start(&self, mode: StartMode) -> Result<(), Refused> {
        let gone = self.finished().is_some_and(|finished| finished.end == End::NotLoaded);
        match (self.starts, mode) {
            (Starts::Cold, StartMode::Warm) => Err(Refused::NoWarmStart),
            (Starts::None, _) => Err(Refused::RunEnds),
            _ if gone => Err(Refused::Gone),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
#[path = "life_tests.rs"]
mod tests;
