//! What Takt asks and orders of the programs of running PLCs.
//!
//! A kernel for programs and Takt talk through two queues in shared pages (`link`; the messages are those of
//! `takt_abi::live`). All of it happens in the supervisor thread, on its tick and for a bounded number of
//! messages: no vCPU thread knows of it, and whatever a guest writes into its pages costs Takt no more than a
//! number of answers that are none. Without a control socket nothing is asked.

mod change;
#[cfg(test)]
mod change_tests;
mod figures;
mod limits;
mod link;
mod retain;
#[cfg(test)]
mod tests;
mod versions;
mod watching;
mod writes;

use std::io;
use std::time::Duration;

use takt_abi::live::Range;
use takt_channel::{Misaligned, OpenError};
use takt_plan::{Admission, Partition, PartitionFile, live_channels};
use takt_scheduler::time::Nanos;
use thiserror::Error;

use crate::channels::Channels;
use crate::control::protocol::{ErrorKind, EventKind, ForcedStatus, Load, Refusal, VersionStatus};
use crate::memory::MemoryError;
use crate::report;
use crate::saver::{Files, Saver};
pub use change::Banks;
use change::ProgramChanges;
pub use figures::Figures;
use limits::ProgramLimits;
use link::Received;
pub use link::{Link, NotSent};
use retain::Retaining;
pub use watching::Sampled;
use watching::Watching;
pub use writes::ValueOrder;
use writes::{WriteResult, Writes};

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
    /// Of the last order of values.
    ticket: u64,
    /// What came of orders of values of which their clients have not been told.
    results: Vec<(u64, Nanos, Result<String, Refusal>)>,
    /// What writes retained values, if there are files for them.
    saver: Option<Saver>,
}

/// A partition with programs.
pub struct Running {
    link: Link,
    limits: Vec<ProgramLimits>,
    figures: Figures,
    watching: Watching,
    writes: Writes,
    /// Clients whose watches have ended, and have not been told.
    ended: Vec<(u64, String)>,
    /// Other versions of the programs.
    changes: ProgramChanges,
    /// What the programs retain.
    retaining: Retaining,
    /// What is to be told of that.
    retained: Vec<String>,
}

/// What has happened in a turn.
#[derive(Default)]
pub struct Turn {
    /// Values for clients, with the partition of each.
    pub samples: Vec<(usize, Sampled)>,
    /// Events, with the partition of each.
    pub events: Vec<(usize, EventKind, String)>,
    /// Clients whose watches have ended, and why.
    pub unwatched: Vec<(u64, String)>,
    /// A program runs another version: what clients know of places holds no longer.
    pub exchanged: bool,
}

/// How long the result of an order of values waits for its client.
const RESULT_KEPT: Nanos = Nanos::from_millis(5_000);

impl Live {
    /// Opens the queues. The headers of all partitions' regions must have been written, and no guest may run.
    ///
    /// # Errors
    /// See [`LiveError`].
    pub fn open(
        file: &PartitionFile,
        channels: &Channels<'_>,
        files: &Files,
        saver: Option<Saver>,
    ) -> Result<Self, LiveError> {
        let mut queues = channels.live().chunks_exact(2);
        let open = |partition: &Partition| -> Result<Option<Running>, LiveError> {
            if live_channels(partition).is_none() {
                return Ok(None);
            }
            let Some([orders, answers]) = queues.next() else { return Err(LiveError::Missing) };
            let limits = partition.programs().iter().map(ProgramLimits::new).collect();
            let admission = Admission::of(file, partition.id());
            let changes = ProgramChanges::of(partition.programs(), admission);
            let mut running = Running::new(Link::open(orders, answers)?, limits, changes);
            let beginning = |place| files.beginning(partition, place);
            let own_file = |place| beginning(place).and_then(|beginning| beginning.file);
            running.retaining = Retaining::of(partition.programs(), own_file);
            let all = (0..partition.programs().len()).filter_map(beginning);
            running.retained = all.flat_map(|beginning| beginning.news.clone()).collect();
            Ok(Some(running))
        };
        let partitions = file.partitions().iter().map(open).collect::<Result<_, _>>()?;
        Ok(Self { partitions, saver, ..Self::default() })
    }

    /// Takes what the kernels have sent, and asks what is to be asked again. `banks` gives those of a partition, and
    /// `windows` how many it has had.
    pub fn on_tick<'b>(
        &mut self,
        now: Nanos,
        banks: impl Fn(usize) -> Option<&'b Banks>,
        windows: impl Fn(usize) -> u64,
    ) -> Turn {
        let mut turn = Turn::default();
        let mut results = Vec::new();
        while let Some((number, result)) = self.saver.as_mut().and_then(Saver::outcome) {
            for running in self.partitions.iter_mut().flatten() {
                running.retaining.outcome(number, &result, &mut running.retained);
            }
        }
        for (id, running) in self.partitions.iter_mut().enumerate() {
            let Some(running) = running else { continue };
            running.on_tick(now, id, banks(id), &mut turn, &mut results);
            let Running { retaining, retained, .. } = running;
            retaining.save(self.saver.as_mut(), windows(id), now, retained);
            let news = retained.drain(..);
            turn.events.extend(news.map(|text| (id, EventKind::Retained, text)));
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
        let Running { watching, limits, changes, .. } = self.running(partition)?;
        ranges.iter().try_for_each(|range| changes.is_settled(range.program))?;
        let watched = watching.watch(client, ranges, interval, limits);
        watched.map_err(|text| Refusal::new(ErrorKind::Refused, text))
    }

    /// Forgets clients that are gone.
    pub fn keep(&mut self, is_there: impl Fn(u64) -> bool) {
        for running in self.partitions.iter_mut().flatten() {
            running.watching.keep(&is_there);
        }
    }

    /// Orders something of values; the ticket is for [`result`](Self::result).
    ///
    /// # Errors
    /// Why it is not ordered.
    pub fn order_values(
        &mut self,
        partition: usize,
        order: ValueOrder,
        now: Nanos,
    ) -> Result<u64, Refusal> {
        let ticket = self.ticket.wrapping_add(1);
        let Running { writes, changes, link, limits, .. } = self.running(partition)?;
        let value = match &order {
            ValueOrder::Write(value) | ValueOrder::Force(value) => Some(value.point.range),
            ValueOrder::Release(point) => point.map(|point| point.range),
        };
        if let Some(range) = value {
            // First, since how many bytes there are is only known of the version that runs.
            if !matches!(order, ValueOrder::Release(_)) {
                changes.is_settled(range.program)?;
            }
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
        writes.order(ticket, order, link, now)?;
        self.ticket = ticket;
        Ok(ticket)
    }

    /// What came of an order of values, once.
    pub fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>> {
        let at = self.results.iter().position(|(of, ..)| *of == ticket)?;
        Some(self.results.swap_remove(at).2)
    }

    /// Takes a part of the next version of a program.
    ///
    /// # Errors
    /// Why it is not taken.
    pub fn load(
        &mut self,
        partition: usize,
        load: &Load,
        banks: &Banks,
    ) -> Result<String, Refusal> {
        let Running { changes, link, .. } = self.running(partition)?;
        changes.load(load, banks, link)
    }

    /// Changes a program to the version that is prepared.
    ///
    /// # Errors
    /// Why it is not changed.
    pub fn commit(&mut self, partition: usize, program: &str) -> Result<String, Refusal> {
        self.running(partition)?.commit(program)
    }

    /// Changes a program back, or gives up a version that is only prepared.
    ///
    /// # Errors
    /// Why it is not changed.
    pub fn roll_back(&mut self, partition: usize, program: &str) -> Result<String, Refusal> {
        self.running(partition)?.roll_back(program)
    }

    /// Which versions the programs of a partition have.
    ///
    /// # Errors
    /// If it has none.
    pub fn versions(&mut self, partition: usize) -> Result<Vec<VersionStatus>, Refusal> {
        Ok(self.running(partition)?.changes.status())
    }

    /// Writes what programs retain, since the run is over.
    ///
    /// # Errors
    /// What kept some of it from being written within this time.
    pub fn finish(&mut self, now: Nanos, at_most: Duration) -> io::Result<()> {
        let Some(mut saver) = self.saver.take() else { return Ok(()) };
        for running in self.partitions.iter_mut().flatten() {
            running.retaining.save_last(&mut saver, now);
        }
        saver.finish(at_most)
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
        running.map_or_else(Vec::new, |running| running.writes.forced())
    }

    /// What operators did with the values of a partition, for the report.
    #[must_use]
    pub fn told(&self, partition: usize) -> Option<report::Operator> {
        self.partitions.get(partition)?.as_ref()?.writes.told()
    }
}

impl Running {
    fn new(link: Link, limits: Vec<ProgramLimits>, changes: ProgramChanges) -> Self {
        let (figures, watching) = (Figures::default(), Watching::default());
        let (writes, ended) = (Writes::default(), Vec::new());
        let (retaining, retained) = (Retaining::default(), Vec::new());
        Self { link, limits, figures, watching, writes, ended, changes, retaining, retained }
    }

    fn commit(&mut self, program: &str) -> Result<String, Refusal> {
        let place = self.changes.place(program)?;
        self.may_leave_version(place)?;
        let said = self.changes.commit(program, &mut self.link)?;
        self.leave_version(place, program);
        Ok(said)
    }

    fn roll_back(&mut self, program: &str) -> Result<String, Refusal> {
        let place = self.changes.place(program)?;
        let is_entered = self.changes.is_entered(place);
        if is_entered {
            self.may_leave_version(place)?;
        }
        let said = self.changes.roll_back(program, &mut self.link)?;
        if is_entered {
            self.leave_version(place, program);
        }
        Ok(said)
    }

    /// What is forced means places in the version that runs.
    fn may_leave_version(&self, place: u8) -> Result<(), Refusal> {
        let reason = self.writes.keep_version_of(place);
        reason.map_or(Ok(()), |text| Err(Refusal::new(ErrorKind::Refused, text)))
    }

    /// So does what is watched.
    fn leave_version(&mut self, place: u8, program: &str) {
        let text = format!(
            "values of {program} are watched no longer, because it changes to another version: ask for the status, and \
             watch anew"
        );
        let Self { watching, retaining, .. } = self;
        let clients = watching.leave(place).into_iter().filter(|client| !retaining.left(*client));
        self.ended.extend(clients.map(|client| (client, text.clone())));
    }

    fn on_tick(
        &mut self,
        now: Nanos,
        id: usize,
        banks: Option<&Banks>,
        turn: &mut Turn,
        results: &mut Vec<(usize, u64, WriteResult)>,
    ) {
        let restarted = self.link.has_restarted();
        if restarted {
            self.figures.forget();
            self.watching.send_again();
            self.changes.guest_has_started(banks);
            if banks.is_some_and(|banks| banks.programs.was_seen()) {
                self.retaining.started_cold();
            }
            let ended = self.writes.forget();
            turn.events.extend(ended.map(|text| (id, EventKind::Released, text)));
        }
        let Self { link, figures, limits, watching, writes, ended, changes, retaining, retained } =
            self;
        link.receive(|received| match received {
            Received::Answer(number, answer) => {
                figures.take(answer);
                changes.take(number, answer, banks);
                let result = writes.take(number, answer, now);
                results.extend(result.map(|(ticket, result)| (id, ticket, result)));
            }
            Received::Sample(head, bytes) => {
                watching.take(head, bytes, |sampled| {
                    let sampled = retaining.take(sampled, banks);
                    turn.samples.extend(sampled.map(|sampled| (id, sampled)));
                });
            }
        });
        for place in changes.exchanged() {
            let Some(image) = changes.image(place) else { continue };
            figures.runs(place, image.hash());
            if let Some(limits) = limits.get_mut(place) {
                limits.areas[0] = image.state_bytes();
            }
            retaining.entered(place, &image);
            turn.exchanged = true;
        }
        turn.events.extend(changes.news().map(|text| (id, EventKind::Change, text)));
        turn.unwatched.append(ended);
        let late = writes.late(now, restarted);
        results.extend(late.into_iter().map(|(ticket, result)| (id, ticket, result)));
        retaining.watch(watching, limits, changes, retained);
        watching.send(link);
        figures.ask(link, now);
        changes.ask(link);
    }
}
