//! What can be asked of a run.

use takt_scheduler::time::Nanos;

use super::protocol::{Load, Mode, Range, Refusal, Status, TraceStart, VersionStatus};
use crate::live::ValueOrder;

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

    /// Orders something of values; the ticket is for [`result`](Self::result).
    ///
    /// # Errors
    /// Why they are not changed.
    fn order_values(&mut self, partition: &str, order: ValueOrder) -> Result<u64, Refusal>;

    /// What came of an order of values; `None` until that is known.
    fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>>;

    /// Takes a part of the next version of a program.
    ///
    /// # Errors
    /// Why it is not taken.
    fn load(&mut self, load: Load) -> Result<String, Refusal>;

    /// Changes a program to the version that is prepared.
    ///
    /// # Errors
    /// Why it is not changed.
    fn commit(&mut self, partition: &str, program: &str) -> Result<String, Refusal>;

    /// Changes a program back.
    ///
    /// # Errors
    /// Why it is not changed.
    fn roll_back(&mut self, partition: &str, program: &str) -> Result<String, Refusal>;

    /// Which versions the programs of a partition have.
    ///
    /// # Errors
    /// Why that cannot be told.
    fn versions(&mut self, partition: &str) -> Result<Vec<VersionStatus>, Refusal>;

    /// Which partition that is, and whether its console is a terminal, which can be typed at.
    ///
    /// # Errors
    /// If there is no such partition.
    fn console(&mut self, partition: &str) -> Result<(usize, bool), Refusal>;

    /// Types at a console. Returns how many bytes there was room for.
    ///
    /// # Errors
    /// Why there is nothing to type at.
    fn type_bytes(&mut self, partition: &str, bytes: &[u8]) -> Result<usize, Refusal>;

    /// What a trace that begins now begins with.
    fn trace(&self) -> TraceStart;
}
