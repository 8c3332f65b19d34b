//! What Takt asks and orders of the programs of running PLCs.
//!
//! A kernel for programs and Takt talk through two queues in shared pages ([`link`]; the messages are those of
//! `takt_abi::live`). All of it happens in the supervisor thread, on its tick and for a bounded number of
//! messages: no vCPU thread knows of it, and whatever a guest writes into its pages costs Takt no more than a
//! number of answers that are none. Without a control socket nothing is asked.

mod figures;
mod link;
#[cfg(test)]
mod tests;

use takt_channel::{Misaligned, OpenError};
use takt_plan::{PartitionFile, live_channels};
use takt_scheduler::time::Nanos;
use thiserror::Error;

use crate::channels::Channels;
use crate::memory::MemoryError;
pub use figures::Figures;
pub use link::{Link, NotSent};

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
}

/// A partition with programs.
pub struct Running {
    link: Link,
    figures: Figures,
}

impl Live {
    /// Opens the queues. The headers of all partitions' regions must have been written, and no guest may run.
    ///
    /// # Errors
    /// See [`LiveError`].
    pub fn open(file: &PartitionFile, channels: &Channels<'_>) -> Result<Self, LiveError> {
        let mut queues = channels.live().chunks_exact(2);
        let open = |partition| -> Result<Option<Running>, LiveError> {
            if live_channels(partition).is_none() {
                return Ok(None);
            }
            let Some([orders, answers]) = queues.next() else { return Err(LiveError::Missing) };
            let link = Link::open(orders, answers)?;
            Ok(Some(Running { link, figures: Figures::default() }))
        };
        let partitions = file.partitions().iter().map(open).collect::<Result<_, _>>()?;
        Ok(Self { partitions })
    }

    /// Takes the answers, and asks what is to be asked again.
    pub fn on_tick(&mut self, now: Nanos) {
        self.partitions.iter_mut().flatten().for_each(|running| running.on_tick(now));
    }

    /// What is known of the programs of a partition; `None` if it has none.
    #[must_use]
    pub fn figures(&self, partition: usize) -> Option<&Figures> {
        Some(&self.partitions.get(partition)?.as_ref()?.figures)
    }
}

impl Running {
    fn on_tick(&mut self, now: Nanos) {
        if self.link.has_restarted() {
            self.figures.forget();
        }
        let Self { link, figures } = self;
        link.receive(|_, answer| figures.take(answer));
        figures.ask(link, now);
    }
}
