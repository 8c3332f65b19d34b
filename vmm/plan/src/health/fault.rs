//! The errors that the health monitor tells apart.

use std::fmt;

/// An error of a partition. The partition file and the documentation say "error", as ARINC 653
/// does; in Rust that word is taken.
///
/// The first seven are those of ARINC 653 Part 1, without the power failure, of which Takt learns
/// nothing. The next four are ends that a machine has and a process does not. Then the host's, and what
/// hardware tells of that all partitions suffer from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A window ended before the guest was done, or a release passed without a scan.
    DeadlineMissed,
    /// The guest itself reports an error of its application.
    ApplicationError,
    /// An arithmetic exception.
    NumericError,
    /// Something was asked for that the partition has not.
    IllegalRequest,
    /// A stack is used up.
    StackOverflow,
    /// An access that the guest's own memory protection refuses, or another exception.
    MemoryViolation,
    /// The machine, or KVM, failed.
    HardwareFault,
    /// The virtual processor shut down: an exception while handling a double fault.
    ProcessorShutdown,
    /// The guest asked for a restart.
    PartitionReset,
    /// The guest's watchdog has expired.
    PartitionSilent,
    /// The guest ended itself in order.
    PartitionEnded,
    /// The host's time-stamp counter has turned bad, on which all time of the guest lies.
    ClockFault,
    /// The guest has locked the memory bus for all processors, more often than it may.
    BusLock,
}

/// All errors, in the order of their declaration.
pub const FAULTS: [Fault; 13] = [
    Fault::DeadlineMissed,
    Fault::ApplicationError,
    Fault::NumericError,
    Fault::IllegalRequest,
    Fault::StackOverflow,
    Fault::MemoryViolation,
    Fault::HardwareFault,
    Fault::ProcessorShutdown,
    Fault::PartitionReset,
    Fault::PartitionSilent,
    Fault::PartitionEnded,
    Fault::ClockFault,
    Fault::BusLock,
];

impl Fault {
    /// The name in the partition file and in the report.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Fault::DeadlineMissed => "deadline-missed",
            Fault::ApplicationError => "application-error",
            Fault::NumericError => "numeric-error",
            Fault::IllegalRequest => "illegal-request",
            Fault::StackOverflow => "stack-overflow",
            Fault::MemoryViolation => "memory-violation",
            Fault::HardwareFault => "hardware-fault",
            Fault::ProcessorShutdown => "processor-shutdown",
            Fault::PartitionReset => "partition-reset",
            Fault::PartitionSilent => "partition-silent",
            Fault::PartitionEnded => "partition-ended",
            Fault::ClockFault => "clock-fault",
            Fault::BusLock => "bus-lock",
        }
    }

    /// The error of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Fault> {
        FAULTS.into_iter().find(|fault| fault.name() == name)
    }

    /// True if a Linux can have this error. Takt sees no exceptions of a Linux, and knows of no
    /// deadline of it.
    #[must_use]
    pub const fn of_linux(self) -> bool {
        matches!(
            self,
            Fault::IllegalRequest
                | Fault::HardwareFault
                | Fault::ProcessorShutdown
                | Fault::PartitionReset
                | Fault::PartitionSilent
                | Fault::PartitionEnded
                | Fault::ClockFault
                | Fault::BusLock
        )
    }

    /// True if a PLC guest can have this error. It has no reset line, and one that is silent misses
    /// its deadline.
    #[must_use]
    pub const fn of_plc(self) -> bool {
        !matches!(self, Fault::PartitionReset | Fault::PartitionSilent)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_has_its_place_and_its_name() {
        for (place, fault) in FAULTS.into_iter().enumerate() {
            assert_eq!(fault as usize, place);
            assert_eq!(Fault::from_name(fault.name()), Some(fault));
            assert!(fault.of_linux() || fault.of_plc());
        }
        assert_eq!(Fault::from_name("power-fail"), None);
    }
}
