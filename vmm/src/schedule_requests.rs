//! Where an operator asks for another schedule, and learns when it holds.

use std::fmt;
use std::sync::Arc;

use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::switch::{ScheduleState, Status, Switch, SwitchError};
use takt_scheduler::time::{Nanos, Timebase, Tsc};

/// The operator's side of the [`ScheduleState`].
pub struct ScheduleRequests {
    board: Arc<ScheduleState>,
    names: Vec<String>,
    base: Timebase,
    /// The last switch that was told of.
    told: Option<Nanos>,
}

/// A switch that has taken effect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Switched {
    /// When.
    pub at: Tsc,
    /// Since the epoch.
    pub offset: Nanos,
    /// The schedule that holds since then.
    pub schedule: ScheduleId,
    name: String,
    late: bool,
}

impl fmt::Display for Switched {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = self.offset.0 as f64 / 1e6;
        write!(f, "schedule \"{}\" holds since {ms:.3} ms", self.name)?;
        let late =
            "; the host held up its adoption, so windows around that may be of both schedules";
        f.write_str(if self.late { late } else { "" })
    }
}

impl ScheduleRequests {
    /// A desk for the schedules of these names.
    #[must_use]
    pub fn new(board: Arc<ScheduleState>, names: &[String], base: Timebase) -> Self {
        Self { board, names: names.to_vec(), base, told: None }
    }

    /// The line on which the schedules lie.
    #[must_use]
    pub fn base(&self) -> Timebase {
        self.base
    }

    /// Which schedule holds when.
    #[must_use]
    pub fn switch(&self) -> Switch {
        self.board.switch()
    }

    /// Asks for the schedule after the one that holds, in the order of the file; returns the
    /// answer for the operator.
    pub fn ask_for_next(&self) -> String {
        let now = self.now();
        let current = self.board.status(now).current;
        let next = ScheduleId((current.0 + 1) % self.names.len());
        let name = &self.names[next.0];
        match self.board.request(next, now) {
            Ok(()) => format!("schedule \"{name}\" will hold from the end of a frame on"),
            Err(error) => format!("schedule \"{name}\": {error}"),
        }
    }

    /// Asks for the schedule at this position in the file.
    ///
    /// # Errors
    /// See [`SwitchError`].
    pub fn ask_for(&self, position: usize) -> Result<(), SwitchError> {
        self.board.request(ScheduleId(position), self.now())
    }

    /// Where the schedule stands at this time since the epoch.
    #[must_use]
    pub fn status(&self, now: Nanos) -> Status {
        self.board.status(now)
    }

    /// The switch that has taken effect since the last call.
    pub fn poll(&mut self) -> Option<Switched> {
        let status = self.board.status(self.now());
        if status.last_switch == self.told {
            return None;
        }
        self.told = status.last_switch;
        let offset = status.last_switch?;
        let name = self.names[status.current.0].clone();
        let at = self.base.instant(offset);
        Some(Switched { at, offset, schedule: status.current, name, late: status.late })
    }

    /// Time since the epoch.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.base.offset(Tsc::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::time::TscFrequency;

    #[test]
    fn a_switch_is_promised_and_told_once() {
        let frame = Nanos::from_micros(100);
        let board = Arc::new(ScheduleState::new(frame, 2));
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        let names = ["production".to_owned(), "maintenance".to_owned()];
        let mut desk = ScheduleRequests::new(board.clone(), &names, base);
        assert_eq!(desk.poll(), None);
        assert!(desk.ask_for_next().starts_with("schedule \"maintenance\" will hold"));
        assert!(desk.ask_for_next().contains("under way"));
        board.adopt(|| desk.now());
        while desk.now().0 < board.switch().frame * frame.0 {}
        let switched = desk.poll().unwrap();
        assert_eq!(switched.offset.0, board.switch().frame * frame.0);
        assert!(switched.to_string().starts_with("schedule \"maintenance\" holds since"));
        assert!(!switched.to_string().contains("held up"));
        let late = Switched { late: true, ..switched };
        assert!(late.to_string().contains("held up its adoption"), "{late}");
        assert_eq!(desk.poll(), None);
    }
}
