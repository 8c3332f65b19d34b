//! What an operator orders of one partition, and what he is told of it. [`Life`](crate::life::Life) decides.

use takt_scheduler::time::Nanos;

use super::protocol::{ErrorKind, EventKind, Refusal, State};
use crate::account::Account;
use crate::boot::StartMode;
use crate::life::{Order, Refused, Told};
use crate::vcpu::guest::End;

/// What came of an order once its partition had stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Which kind of event that is.
    pub kind: EventKind,
    /// For people.
    pub text: String,
}

impl Account {
    /// How it has ended, in words.
    #[must_use]
    pub fn end(&self) -> Option<String> {
        let finished = self.life.finished()?;
        if self.life.state() == State::Stopped && finished.end == End::Stopped {
            return Some("stopped by an operator".to_owned());
        }
        Some(finished.end.to_string())
    }

    /// CPU time that the threads of its processors have used so far.
    #[must_use]
    pub fn cpu_time(&self) -> Nanos {
        let last = || self.life.finished().map_or(Nanos::ZERO, |finished| finished.cpu_time);
        let further = self.further.iter().filter_map(|control| control.cpu_time());
        let all = |first| further.fold(first, Nanos::plus);
        self.control.cpu_time().map_or_else(last, all)
    }

    /// Does what an operator orders. Gives the outcome if that is known at once; else it comes when the partition
    /// has stopped.
    ///
    /// # Errors
    /// If its state does not allow it, or it cannot be started.
    pub fn operate(&mut self, order: Order) -> Result<Option<Outcome>, Refusal> {
        let effects = self.life.order(order).map_err(|refused| self.refusal(refused))?;
        self.carry_out(&effects);
        Ok(effects.told.and_then(|told| self.outcome(told)))
    }

    /// What came of an order, if that is what is told.
    #[must_use]
    pub fn outcome(&self, told: Told) -> Option<Outcome> {
        let Told::Obeyed { instead, result } = told else { return None };
        let (kind, text) = match result {
            Ok(Order::Stop) => (EventKind::Stopped, "stopped by an operator".to_owned()),
            Ok(Order::Start(mode) | Order::Restart(mode)) => {
                let mode = match mode {
                    StartMode::Cold => "cold",
                    StartMode::Warm => "warm",
                };
                (EventKind::Restarted, format!("{mode} start by an operator"))
            }
            Err(refused) => (EventKind::Ended, self.refusal(refused).text),
        };
        // It may have ended by itself before it saw the order.
        let how = instead.map_or_else(String::new, |end| format!("{end}; "));
        Some(Outcome { kind, text: format!("{how}{text}") })
    }

    fn refusal(&self, refused: Refused) -> Refusal {
        let name = &self.name;
        match refused {
            Refused::While(state) => {
                let state = match state {
                    State::Running => "runs",
                    State::Stopping => "is stopping",
                    State::Restarting => "is being restarted",
                    State::Stopped => "has stopped already",
                    State::Ended => "has ended already",
                };
                Refusal::new(ErrorKind::Refused, format!("{name} {state}"))
            }
            Refused::NoWarmStart => {
                let why = "a Linux retains nothing, so it has no warm start";
                Refusal::new(ErrorKind::Unsupported, format!("{name}: {why}"))
            }
            Refused::Gone => {
                Refusal::new(ErrorKind::Refused, format!("{name}: its thread is gone"))
            }
            Refused::RunEnds => {
                let why = "it is not started any more, since the run ends";
                Refusal::new(ErrorKind::Refused, format!("{name}: {why}"))
            }
        }
    }
}
