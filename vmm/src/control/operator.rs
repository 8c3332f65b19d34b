//! What can be asked of a run.

use takt_scheduler::time::Nanos;

use super::protocol::{Mode, Range, Refusal, Status, TraceStart};
use crate::live::Change;

/// A run, as an operator sees it. Every call returns at once; the text says what will happen.
pub trait Operator {
    /// Time since its epoch.
    fn now(&self) -> Nanos;

    /// How the run stands.
    fn status(&mut self) -> Status;

    /// Asks a partition to stop.
    ///
    /// # Errors
    /// Why it does not.
    fn stop(&mut self, partition: &str) -> Result<String, Refusal>;

    /// Starts a partition that has stopped or ended.
    ///
    /// # Errors
    /// Why it is not started.
    fn start(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal>;

    /// Asks a partition to stop and starts it again, or just starts it.
    ///
    /// # Errors
    /// Why it is not started.
    fn restart(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal>;

    /// Asks for a schedule.
    ///
    /// # Errors
    /// Why it will not hold.
    fn switch_schedule(&mut self, name: &str) -> Result<String, Refusal>;

    /// Lets a client look at values of a partition's programs, no ranges: at none. Returns how many bytes it gets each
    /// time.
    ///
    /// # Errors
    /// Why it does not see them.
    fn watch(
        &mut self,
        client: u64,
        partition: &str,
        ranges: Vec<Range>,
        interval: Nanos,
    ) -> Result<u64, Refusal>;

    /// Asks for a change of values; the ticket is for [`result`](Self::result).
    ///
    /// # Errors
    /// Why they are not changed.
    fn change(&mut self, partition: &str, change: Change) -> Result<u64, Refusal>;

    /// What came of a change; `None` until that is known.
    fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>>;

    /// What a trace that begins now begins with.
    fn trace(&self) -> TraceStart;
}
