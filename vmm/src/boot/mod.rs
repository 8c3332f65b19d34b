//! How each kind of guest gets to its first instruction.

pub mod acpi;
pub mod linux;
pub mod long_mode;
pub mod plc;
pub mod programs;
pub mod retained;
pub mod touch;

/// What a guest finds when it starts (operating modes of ARINC 653).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartMode {
    /// Memory as the image says, and zero elsewhere.
    Cold,
    /// As cold, but what the image wants to be retained is as it was.
    Warm,
}

/// Why a guest is started anew (start conditions of ARINC 653).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartReason {
    /// A switch of the schedule.
    ScheduleChange,
    /// An operator wants it.
    Operator,
    /// An error.
    HealthMonitor,
}

/// A start that is not a guest's first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// What it finds.
    pub mode: StartMode,
    /// Why.
    pub reason: StartReason,
}
