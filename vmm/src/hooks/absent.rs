//! The hooks of a build that users get: none.

use takt_scheduler::table::Cpu;
use takt_scheduler::time::Nanos;

use crate::account::Account;
use crate::prepare::WindowEnforcer;
use crate::run_error::RunError;
use crate::sandbox::Mode;

/// No options.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Hooks {}

/// No wake-up is made late.
#[derive(Clone, Copy, Debug, Default)]
pub struct LateWakeUp;

/// No step of the start is made to fail.
#[derive(Debug)]
pub struct Steps;

impl Hooks {
    /// The steps of a start.
    pub const fn steps(&self) -> Steps {
        Steps
    }

    /// Windows are ended by kicks.
    pub const fn kicks(&self) -> bool {
        true
    }

    /// Processors are where the file says.
    #[must_use]
    pub const fn processors(&self, cpus: Vec<Cpu>) -> Vec<Cpu> {
        cpus
    }

    /// The timers of a Linux are kept out of windows.
    #[must_use]
    pub const fn quiet(&self) -> bool {
        true
    }

    /// No wake-up is made late.
    pub const fn late_wake_up(&self) -> LateWakeUp {
        LateWakeUp
    }

    /// No thread makes a forbidden call.
    ///
    /// # Errors
    /// Never.
    pub const fn arm(&self, _: &[Account], _: &[WindowEnforcer]) -> Result<(), RunError> {
        Ok(())
    }

    /// No thread panics.
    ///
    /// # Errors
    /// Never.
    pub const fn start_panicking(&self, _: Mode) -> Result<(), RunError> {
        Ok(())
    }

    /// There is nothing to tell of.
    pub const fn told(&self) -> Vec<String> {
        Vec::new()
    }
}

impl LateWakeUp {
    /// How much later the wake-up for this release comes.
    pub const fn delay(self, _: u64) -> Nanos {
        Nanos::ZERO
    }
}

impl Steps {
    /// A step is done.
    ///
    /// # Errors
    /// Never.
    pub const fn pass(&self) -> Result<(), RunError> {
        Ok(())
    }
}

/// The appliance's clock is not steered.
#[must_use]
pub const fn clock_may_be_steered() -> bool {
    false
}
