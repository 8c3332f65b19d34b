//! Windows as they are told to a client that draws them.
//!
//! Instants are values of the time-stamp counter, as they were read: with [`TraceStart`] a client
//! makes of them the file that `takt run --trace` would have written. What a client rebuilds it
//! checks, for it need not be Takt that it talks to.

use serde::{Deserialize, Serialize};
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Timebase, Tsc, TscFrequency};

use crate::{DETOURS_MAX, Detour, Exit, Scan, WindowRecord};

/// What is needed to understand the windows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceStart {
    /// Ticks in a millisecond.
    pub tsc_khz: u32,
    /// Start of the run's first major frame.
    pub epoch_tsc: u64,
    /// When the trace began.
    pub since_tsc: u64,
    /// The schedule that held then.
    pub schedule: String,
    /// All there are, in the order of the partition file.
    pub schedules: Vec<String>,
    /// All partitions, in the order of the partition file.
    pub partitions: Vec<TracedPartition>,
}

/// A partition, and where its windows are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedPartition {
    /// Its name.
    pub name: String,
    /// The CPU that it runs on.
    pub cpu: u64,
}

impl TraceStart {
    /// The line on which the windows lie; `None` if that cannot be one.
    #[must_use]
    pub fn base(&self) -> Option<Timebase> {
        let frequency = TscFrequency::from_khz(self.tsc_khz)?;
        Some(Timebase { epoch: Tsc(self.epoch_tsc), frequency })
    }

    /// The schedule of this name.
    #[must_use]
    pub fn schedule(&self, name: &str) -> Option<ScheduleId> {
        self.schedules.iter().position(|schedule| schedule == name).map(ScheduleId)
    }
}

/// A window that is over. `takt_scheduler` and `docs/timing.md` tell what its instants are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedWindow {
    /// Windows that this client has not been told of, between the one before and this one, because
    /// it did not read fast enough.
    pub dropped_before: u64,
    /// Whose it was.
    pub partition: String,
    /// Which schedule held.
    pub schedule: String,
    /// Number of the release.
    pub release: u64,
    /// Releases before it that were skipped.
    pub skipped: u64,
    /// The release.
    pub release_tsc: u64,
    /// The window's end.
    pub end_tsc: u64,
    /// When the thread was to wake up.
    pub due_tsc: u64,
    /// When it did.
    pub woken_tsc: u64,
    /// When the guest was entered first.
    pub entered_tsc: u64,
    /// When it was left last.
    pub left_tsc: u64,
    /// When the end was enforced by a kick.
    pub kicked_tsc: Option<u64>,
    /// What the guest claims of its scan.
    pub claimed_scan: Option<ClaimedScan>,
    /// The guest's last stamp of all; a claim, too.
    pub claimed_last_stamp_tsc: u64,
    /// Exits to the thread.
    pub exits: u32,
    /// Exits as KVM counts them; 0 if it does not tell.
    pub kernel_exits: u64,
    /// True if the window ended before the scan did.
    pub overrun: bool,
    /// True if it ended after the scan, while tasks of the guest went on.
    pub unfinished: bool,
    /// True if the guest may do something else between its scan and the window's end.
    pub has_tasks: bool,
    /// True if the guest ended in it.
    pub ended: bool,
    /// The first exits after which the guest was entered again, in the order of time.
    pub detours: Vec<TracedDetour>,
}

/// What a guest claims of its scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClaimedScan {
    /// Its start.
    pub start_tsc: u64,
    /// Its end; earlier than the start while it runs.
    pub done_tsc: u64,
}

/// The guest was left and entered again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TracedDetour {
    /// Why.
    pub exit: ExitKind,
    /// The I/O port, or the address in memory.
    pub at: Option<u64>,
    /// When it was left.
    pub left_tsc: u64,
    /// When it was entered again.
    pub entered_tsc: u64,
}

/// Why a guest was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExitKind {
    /// An access to an I/O port.
    Port,
    /// An access to an address without memory.
    Memory,
    /// A signal.
    Signal,
    /// Anything else.
    Other,
}

impl TracedWindow {
    /// What a client is told of a window, of which nothing was dropped so far.
    #[must_use]
    pub fn new(partition: &str, schedule: &str, w: &WindowRecord, detours: &[Detour]) -> Self {
        TracedWindow {
            dropped_before: 0,
            partition: partition.to_owned(),
            schedule: schedule.to_owned(),
            release: w.sequence,
            skipped: w.skipped,
            release_tsc: w.release.0,
            end_tsc: w.end.0,
            due_tsc: w.due.0,
            woken_tsc: w.woken.0,
            entered_tsc: w.entered.0,
            left_tsc: w.left.0,
            kicked_tsc: w.kicked.map(|kicked| kicked.0),
            claimed_scan: w
                .claim
                .map(|scan| ClaimedScan { start_tsc: scan.start.0, done_tsc: scan.done.0 }),
            claimed_last_stamp_tsc: w.last_stamp.0,
            exits: w.exits,
            kernel_exits: w.kernel_exits,
            overrun: w.overrun,
            unfinished: w.unfinished,
            has_tasks: w.has_tasks,
            ended: w.ended,
            detours: detours.iter().map(TracedDetour::new).collect(),
        }
    }

    /// The window again; `None` if it cannot be one of the run that `start` tells of.
    #[must_use]
    pub fn record(&self, start: &TraceStart) -> Option<(PartitionId, WindowRecord, Vec<Detour>)> {
        let partition = start.partitions.iter().position(|p| p.name == self.partition)?;
        if self.detours.len() > DETOURS_MAX as usize {
            return None;
        }
        let detours = self.detours.iter().map(TracedDetour::record).collect::<Option<_>>()?;
        let window = WindowRecord {
            sequence: self.release,
            schedule: start.schedule(&self.schedule)?,
            skipped: self.skipped,
            release: Tsc(self.release_tsc),
            end: Tsc(self.end_tsc),
            due: Tsc(self.due_tsc),
            woken: Tsc(self.woken_tsc),
            entered: Tsc(self.entered_tsc),
            left: Tsc(self.left_tsc),
            kicked: self.kicked_tsc.map(Tsc),
            claim: self
                .claimed_scan
                .map(|scan| Scan { start: Tsc(scan.start_tsc), done: Tsc(scan.done_tsc) }),
            last_stamp: Tsc(self.claimed_last_stamp_tsc),
            exits: self.exits,
            kernel_exits: self.kernel_exits,
            overrun: self.overrun,
            unfinished: self.unfinished,
            has_tasks: self.has_tasks,
            ended: self.ended,
        };
        Some((PartitionId(partition), window, detours))
    }
}

impl TracedDetour {
    fn new(detour: &Detour) -> Self {
        let (exit, at) = match detour.exit {
            Exit::Port(port) => (ExitKind::Port, Some(port.into())),
            Exit::Memory(address) => (ExitKind::Memory, Some(address)),
            Exit::Signal => (ExitKind::Signal, None),
            Exit::Other => (ExitKind::Other, None),
        };
        TracedDetour { exit, at, left_tsc: detour.left.0, entered_tsc: detour.entered.0 }
    }

    fn record(&self) -> Option<Detour> {
        let exit = match (self.exit, self.at) {
            (ExitKind::Port, Some(port)) => Exit::Port(u16::try_from(port).ok()?),
            (ExitKind::Memory, Some(address)) => Exit::Memory(address),
            (ExitKind::Signal, None) => Exit::Signal,
            (ExitKind::Other, None) => Exit::Other,
            _ => return None,
        };
        Some(Detour { exit, left: Tsc(self.left_tsc), entered: Tsc(self.entered_tsc) })
    }
}
