//! What an operator has ordered of one partition, and how far that has got.
//!
//! A vCPU's thread is never waited for. An order to stop is a flag and a kick; the thread's word
//! that it has stopped comes like that of any other end, and only then the rest of the order is
//! carried out:
//!
//! ```text
//!            stop                     end                 start
//!  running --------> stop pending ----------> stopped --------------> running
//!     |   restart                     end, loaded anew                   ^
//!     +------------> restart pending ------------------------------------+
//! ```
//!
//! A partition that has ended by itself can be started too.

use takt_scheduler::time::Nanos;

use super::protocol::{ErrorKind, EventKind, Refusal, State};
use crate::account::{Account, Finished};
use crate::boot::{Start, StartMode, StartReason};
use crate::vcpu::guest::End;

/// An order whose partition has not stopped yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// To stop.
    Stop,
    /// To stop and start again.
    Restart(StartMode),
}

/// The orders to one partition.
#[derive(Clone, Copy, Debug, Default)]
pub struct Orders {
    pending: Option<Order>,
    /// True if it does not run because of an order.
    stopped: bool,
}

impl Orders {
    /// Nothing will be started again: the run is over.
    pub fn forget(&mut self) {
        self.pending = None;
    }

    /// True if an operator has stopped it, and may start it again.
    #[must_use]
    pub fn stopped(&self) -> bool {
        self.stopped
    }
}

/// What came of an order once its partition had stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Which kind of event that is.
    pub kind: EventKind,
    /// For people.
    pub text: String,
}

impl Account {
    /// What it is doing.
    #[must_use]
    pub fn state(&self) -> State {
        match (self.orders.pending, &self.finished) {
            (Some(Order::Stop), _) => State::Stopping,
            (Some(Order::Restart(_)), _) => State::Restarting,
            (None, Some(_)) if self.orders.stopped => State::Stopped,
            (None, Some(_)) => State::Ended,
            (None, None) => State::Running,
        }
    }

    /// How it has ended, in words.
    #[must_use]
    pub fn end(&self) -> Option<String> {
        let finished = self.finished.as_ref()?;
        if self.orders.stopped && finished.end == End::Stopped {
            return Some("stopped by an operator".to_owned());
        }
        Some(finished.end.to_string())
    }

    /// CPU time that its thread has used so far.
    #[must_use]
    pub fn cpu_time(&self) -> Nanos {
        let last = || self.finished.map_or(Nanos::ZERO, |finished| finished.cpu_time);
        self.control.cpu_time().unwrap_or_else(last)
    }

    /// Orders it to stop.
    ///
    /// # Errors
    /// If it does not run.
    pub fn order_stop(&mut self) -> Result<String, Refusal> {
        match self.state() {
            State::Running => {
                self.order(Order::Stop);
                Ok(format!("{} stops", self.name))
            }
            state => Err(self.not_while(state)),
        }
    }

    /// Starts it, now that it has stopped or ended.
    ///
    /// # Errors
    /// If it runs, cannot be started, or its image cannot be loaded.
    pub fn order_start(&mut self, mode: StartMode) -> Result<Outcome, Refusal> {
        match self.state() {
            State::Stopped | State::Ended => self.start_anew(mode),
            state => Err(self.not_while(state)),
        }
    }

    /// Orders it to stop and start again; gives the outcome at once if it does not run.
    ///
    /// # Errors
    /// If another order is pending, or it cannot be started.
    pub fn order_restart(&mut self, mode: StartMode) -> Result<Option<Outcome>, Refusal> {
        match self.state() {
            State::Running => {
                self.may_start(mode)?;
                self.order(Order::Restart(mode));
                Ok(None)
            }
            State::Stopped | State::Ended => self.start_anew(mode).map(Some),
            state => Err(self.not_while(state)),
        }
    }

    /// Its thread has stopped. If that was ordered, does the rest of the order and says what came
    /// of it.
    pub fn obey(&mut self, finished: Finished) -> Option<Outcome> {
        let order = self.orders.pending.take()?;
        self.control.halted();
        // It may have ended by itself before it saw the order.
        let how = match finished.end {
            End::Stopped => String::new(),
            end => format!("{end}; "),
        };
        self.finished = Some(finished);
        self.orders.stopped = true;
        let Order::Restart(mode) = order else {
            return Some(Outcome {
                kind: EventKind::Stopped,
                text: format!("{how}stopped by an operator"),
            });
        };
        let outcome = self
            .start_anew(mode)
            .unwrap_or_else(|refusal| Outcome { kind: EventKind::Ended, text: refusal.text });
        Some(Outcome { text: format!("{how}{}", outcome.text), ..outcome })
    }

    fn order(&mut self, order: Order) {
        self.orders.pending = Some(order);
        self.control.halt();
    }

    fn start_anew(&mut self, mode: StartMode) -> Result<Outcome, Refusal> {
        self.may_start(mode)?;
        if let Some(restart) = &mut self.restart {
            restart.start(Start { mode, reason: StartReason::Operator });
        }
        self.finished = None;
        self.restarted(mode);
        let mode = match mode {
            StartMode::Cold => "cold",
            StartMode::Warm => "warm",
        };
        let text = format!("{mode} start by an operator");
        Ok(Outcome { kind: EventKind::Restarted, text })
    }

    /// Whether it can be started.
    fn may_start(&self, mode: StartMode) -> Result<(), Refusal> {
        let refused = |error, why| Err(Refusal::new(error, format!("{}: {why}", self.name)));
        let gone = matches!(self.finished, Some(Finished { end: End::NotLoaded, .. }));
        match &self.restart {
            Some(restart) if mode == StartMode::Warm && !restart.retains() => {
                let why = "a Linux retains nothing, so it has no warm start";
                refused(ErrorKind::Unsupported, why)
            }
            Some(_) if !gone => Ok(()),
            _ => refused(ErrorKind::Refused, "its thread is gone"),
        }
    }

    fn not_while(&self, state: State) -> Refusal {
        let state = match state {
            State::Running => "runs",
            State::Stopping => "is stopping",
            State::Restarting => "is being restarted",
            State::Stopped => "has stopped already",
            State::Ended => "has ended already",
        };
        Refusal::new(ErrorKind::Refused, format!("{} {state}", self.name))
    }
}
