//! What Takt asks and orders of the programs of running PLCs.
//!
//! A kernel for programs and Takt talk through two queues in shared pages (`link`; the messages are those of
//! `takt_abi::live`). All of it happens in the supervisor thread, on its tick and for a bounded number of
//! messages: no vCPU thread knows of it, and whatever a guest writes into its pages costs Takt no more than a
//! number of answers that are none. Without a control socket nothing is asked.

mod changes;
mod figures;
mod limits;
mod link;
#[cfg(test)]
mod tests;
mod watching;

use takt_abi::live::Range;
use takt_channel::{Misaligned, OpenError};
use takt_plan::{Partition, PartitionFile, live_channels};
use takt_scheduler::time::Nanos;
use thiserror::Error;

use crate::channels::Channels;
use crate::control::protocol::{ErrorKind, EventKind, ForcedStatus, Refusal};
use crate::memory::MemoryError;
pub use changes::Change;
use changes::{ChangeResult, Changes};
pub use figures::Figures;
use limits::ProgramLimits;
use link::Received;
pub use link::{Link, NotSent};
pub use watching::Sampled;
use watching::Watching;

/// The queues cannot be opened.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum LiveError {
    #[error("cannot map the queues between Takt and a PLC's programs: {0}")]
    Memory(#[from] MemoryError),
    #[error("cannot open the queues between Takt and a PLC's programs: {0}")]
    Open(#[from] OpenError),
    #[error("cannot open the queues between Takt and a PLC's programs: {0}")]
    Region(#[from] Misaligned),
    #[error("a queue between Takt and a PLC's programs has no region for its acknowledgement")]
    Missing,
}

/// All partitions with programs.
#[derive(Default)]
pub struct Live {
    /// By position in the partition file.
    partitions: Vec<Option<Running>>,
    /// Of the last change.
    ticket: u64,
    /// What came of changes of which their clients have not been told.
    results: Vec<(u64, Nanos, Result<String, Refusal>)>,
}

/// A partition with programs.
pub struct Running {
    link: Link,
    limits: Vec<ProgramLimits>,
    figures: Figures,
    watching: Watching,
    changes: Changes,
}

/// What has happened in a turn.
#[derive(Default)]
pub struct Turn {
    /// Values for clients, with the partition of each.
    pub samples: Vec<(usize, Sampled)>,
    /// Events, with the partition of each.
    pub events: Vec<(usize, EventKind, String)>,
}

/// How long the result of a change waits for its client.
const RESULT_KEPT: Nanos = Nanos::from_millis(5_000);

impl Live {
    /// Opens the queues. The headers of all partitions' regions must have been written, and no guest may run.
    ///
    /// # Errors
    /// See [`LiveError`].
    pub fn open(file: &PartitionFile, channels: &Channels<'_>) -> Result<Self, LiveError> {
        let mut queues = channels.live().chunks_exact(2);
        let open = |partition: &Partition| -> Result<Option<Running>, LiveError> {
            if live_channels(partition).is_none() {
                return Ok(None);
            }
            let Some([orders, answers]) = queues.next() else { return Err(LiveError::Missing) };
            let limits = partition.programs().iter().map(ProgramLimits::new).collect();
            Ok(Some(Running::new(Link::open(orders, answers)?, limits)))
        };
        let partitions = file.partitions().iter().map(open).collect::<Result<_, _>>()?;
        Ok(Self { partitions, ..Self::default() })
    }

    /// Takes what the kernels have sent, and asks what is to be asked again.
    pub fn on_tick(&mut self, now: Nanos) -> Turn {
        let mut turn = Turn::default();
        let mut results = Vec::new();
        for (id, running) in self.partitions.iter_mut().enumerate() {
            let Some(running) = running else { continue };
            running.on_tick(now, id, &mut turn, &mut results);
        }
        self.results.retain(|(_, until, _)| now < *until);
        for (id, ticket, result) in results {
            let result = result.map(|(kind, text)| {
                turn.events.push((id, kind, text.clone()));
                text
            });
            self.results.push((ticket, now.plus(RESULT_KEPT), result));
        }
        turn
    }

    /// Lets a client look at values of a partition; returns how many bytes it gets each time.
    ///
    /// # Errors
    /// Why not.
    pub fn watch(
        &mut self,
        client: u64,
        partition: usize,
        ranges: Vec<Range>,
        interval: Nanos,
    ) -> Result<u64, Refusal> {
        let Running { watching, limits, .. } = self.running(partition)?;
        let watched = watching.watch(client, ranges, interval, limits);
        watched.map_err(|text| Refusal::new(ErrorKind::Refused, text))
    }

    /// Forgets clients that are gone.
    pub fn keep(&mut self, is_there: impl Fn(u64) -> bool) {
        for running in self.partitions.iter_mut().flatten() {
            running.watching.keep(&is_there);
        }
    }

    /// Orders a change; the ticket is for [`result`](Self::result).
    ///
    /// # Errors
    /// Why it is not ordered.
    pub fn change(&mut self, partition: usize, change: Change, now: Nanos) -> Result<u64, Refusal> {
        let ticket = self.ticket.wrapping_add(1);
        let Running { changes, link, limits, .. } = self.running(partition)?;
        let value = match &change {
            Change::Write(value) | Change::Force(value) => Some(value.point.range),
            Change::Release(point) => point.map(|point| point.range),
        };
        if let Some(range) = value {
            let refused = |text| Refusal::new(ErrorKind::Refused, text);
            let limits = ProgramLimits::find(limits, &range).map_err(refused)?;
            if !limits.force {
                let text = format!(
                    "values of the program {} cannot be written or forced: the partition file does not say \
                     `allow_force = true` for it",
                    limits.name
                );
                return Err(Refusal::new(ErrorKind::Unsupported, text));
            }
        }
        changes.order(ticket, change, link, now)?;
        self.ticket = ticket;
        Ok(ticket)
    }

    /// What came of a change, once.
    pub fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>> {
        let at = self.results.iter().position(|(of, ..)| *of == ticket)?;
        Some(self.results.swap_remove(at).2)
    }

    fn running(&mut self, partition: usize) -> Result<&mut Running, Refusal> {
        let running = self.partitions.get_mut(partition).and_then(Option::as_mut);
        running
            .ok_or_else(|| Refusal::new(ErrorKind::Unsupported, "this partition runs no programs"))
    }

    /// What is known of the programs of a partition; `None` if it has none.
    #[must_use]
    pub fn figures(&self, partition: usize) -> Option<&Figures> {
        Some(&self.partitions.get(partition)?.as_ref()?.figures)
    }

    /// What is forced in a partition.
    #[must_use]
    pub fn forced(&self, partition: usize) -> Vec<ForcedStatus> {
        let running = self.partitions.get(partition).and_then(Option::as_ref);
        running.map_or_else(Vec::new, |running| running.changes.forced())
    }
}

impl Running {
    fn new(link: Link, limits: Vec<ProgramLimits>) -> Self {
        let (figures, watching) = (Figures::default(), Watching::default());
        Self { link, limits, figures, watching, changes: Changes::default() }
    }

    fn on_tick(
        &mut self,
        now: Nanos,
        id: usize,
        turn: &mut Turn,
        results: &mut Vec<(usize, u64, ChangeResult)>,
    ) {
        let restarted = self.link.has_restarted();
        if restarted {
            self.figures.forget();
            self.watching.send_again();
            let ended = self.changes.forget();
            turn.events.extend(ended.map(|text| (id, EventKind::Released, text)));
        }
        let Self { link, figures, watching, changes, .. } = self;
        link.receive(|received| match received {
            Received::Answer(number, answer) => {
                figures.take(answer);
                let result = changes.take(number, answer, now);
                results.extend(result.map(|(ticket, result)| (id, ticket, result)));
            }
            Received::Sample(head, bytes) => {
                watching.take(head, bytes, now, |sampled| turn.samples.push((id, sampled)));
            }
        });
        let late = changes.late(now, restarted);
        results.extend(late.into_iter().map(|(ticket, result)| (id, ticket, result)));
        watching.send(link);
        figures.ask(link, now);
    }
}
