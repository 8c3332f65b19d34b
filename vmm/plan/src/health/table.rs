//! The health monitor's table of one partition.

use std::fmt;

use takt_scheduler::time::Nanos;

use super::fault::{FAULTS, Fault};

/// What follows from an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// It is counted.
    Ignore,
    /// It is counted, and told as an event.
    Log,
    /// The partition stops; the others go on.
    Idle,
    /// The partition starts as for the first time.
    ColdStart,
    /// The partition starts again and keeps what it retains.
    WarmStart,
    /// The run ends.
    ShutDown,
}

/// All actions.
pub const ACTIONS: [Action; 6] = [
    Action::Ignore,
    Action::Log,
    Action::Idle,
    Action::ColdStart,
    Action::WarmStart,
    Action::ShutDown,
];

impl Action {
    /// The name in the partition file and in events.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Action::Ignore => "ignore",
            Action::Log => "log",
            Action::Idle => "idle",
            Action::ColdStart => "cold-start",
            Action::WarmStart => "warm-start",
            Action::ShutDown => "shut-down",
        }
    }

    /// The action of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Action> {
        ACTIONS.into_iter().find(|action| action.name() == name)
    }

    /// True if the guest runs on after it.
    #[must_use]
    pub const fn goes_on(self) -> bool {
        matches!(self, Action::Ignore | Action::Log)
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// How often a partition may be started again for its errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    /// This many times, at most 100,
    pub at_most: u32,
    /// within any span of this length.
    pub within: Nanos,
}

impl Limit {
    /// Where the file says nothing: a fault that comes back at once ends in a standstill within
    /// seconds, and one that comes once a day never does.
    pub const DEFAULT: Limit = Limit { at_most: 3, within: Nanos::from_millis(10_000) };
}

/// What follows from each error of one partition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    actions: [Action; FAULTS.len()],
    limit: Limit,
}

impl Table {
    /// For a PLC of which the file says nothing: it goes on as long as it can, and is not started
    /// again, since the file does not say that its plant can bear it.
    pub const PLC: Table = Table {
        actions: [
            Action::Log,
            Action::Log,
            Action::Idle,
            Action::Log,
            Action::Idle,
            Action::Idle,
            Action::Idle,
            Action::Idle,
            Action::Idle,
            Action::Idle,
            Action::Idle,
            Action::Log,
            Action::Log,
        ],
        limit: Limit::DEFAULT,
    };

    /// For a Linux of which the file says nothing. It looks for devices that are not there, as on
    /// any machine. A restart that it asks for is what its user wants, and so is one for its silence if
    /// he has given it a watchdog. It has no releases that a bad clock could move.
    pub const LINUX: Table = Table::PLC
        .with(Fault::IllegalRequest, Action::Ignore)
        .with(Fault::PartitionReset, Action::ColdStart)
        .with(Fault::PartitionSilent, Action::ColdStart)
        .with(Fault::ClockFault, Action::Ignore);

    /// The same table with another action for one error.
    #[must_use]
    pub const fn with(mut self, fault: Fault, action: Action) -> Table {
        self.actions[fault as usize] = action;
        self
    }

    /// The same table with another limit.
    #[must_use]
    pub const fn within(mut self, limit: Limit) -> Table {
        self.limit = limit;
        self
    }

    /// How often the partition may be started again.
    #[must_use]
    pub const fn limit(&self) -> Limit {
        self.limit
    }

    /// The action for an error.
    #[must_use]
    pub const fn action(&self, fault: Fault) -> Action {
        self.actions[fault as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_action_has_a_name() {
        for action in ACTIONS {
            assert_eq!(Action::from_name(action.name()), Some(action));
        }
        assert_eq!(Action::from_name("restart"), None);
    }

    #[test]
    fn without_a_word_in_the_file_nothing_ends_the_run_or_a_guest_that_can_go_on() {
        for fault in FAULTS {
            assert_ne!(Table::PLC.action(fault), Action::ShutDown);
            let restarts = Table::LINUX.action(fault) == Action::ColdStart;
            assert_eq!(restarts, [Fault::PartitionReset, Fault::PartitionSilent].contains(&fault));
        }
        for survived in [
            Fault::DeadlineMissed,
            Fault::ApplicationError,
            Fault::IllegalRequest,
            Fault::ClockFault,
            Fault::BusLock,
        ] {
            assert_eq!(Table::PLC.action(survived), Action::Log);
        }
        assert_eq!(Table::LINUX.action(Fault::IllegalRequest), Action::Ignore);
        assert_eq!(Table::LINUX.action(Fault::BusLock), Action::Log);
    }

    #[test]
    fn a_row_changes_its_error_only() {
        for changed in FAULTS {
            let table = Table::PLC.with(changed, Action::ShutDown);
            for fault in FAULTS {
                let is = table.action(fault) == Action::ShutDown;
                assert_eq!(is, fault == changed, "{fault}");
            }
        }
    }
}
