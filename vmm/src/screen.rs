//! The screen: one for all guests and Takt itself, with or without a reader.
//!
//! Linux's output appears as it comes; a PLC's, and Takt's own, a line at a time with its name in
//! front, never in the middle of another line of theirs.
//!
//! No guest can drown another, nor Takt's own lines. Each partition has a budget of bytes and of lines
//! (`Budget`), and a lane of its own in the [`Outlet`] that leads to standard output. What is beyond
//! either is refused, and the caller counts it; Takt's lines have no budget but a lane. A guest that can
//! wait need not be refused anything: [`allowance`](Screen::allowance) says how much to take from it, which
//! is all once the reader has stopped for `PATIENCE`, since a guest should not stand still because of a
//! terminal that somebody has suspended.

pub(crate) mod budget;

use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_devices::output::Allowance;
use takt_scheduler::table::PartitionId;

use crate::outlet::Outlet;
use budget::Budget;

/// Room for Takt's own lines: some 150.
pub const OWN_LANE: usize = 16 << 10;
/// Room for those of a partition: what its ring holds, twice.
pub const LANE: usize = 32 << 10;
/// A reader that takes nothing for so long has stopped: one that reads at 9600 baud takes a step of the
/// outlet in that time.
const PATIENCE: Duration = Duration::from_millis(1_200);
/// Losses of a partition are told of this often at most.
const TOLD_EVERY: Duration = Duration::from_secs(1);

/// The lane of Takt's own lines.
pub const OWN: usize = 0;

const fn lane(partition: PartitionId) -> usize {
    partition.0 + 1
}

/// The quotas of an outlet for the screen of so many partitions.
#[must_use]
pub fn quotas(partitions: usize) -> Vec<usize> {
    let mut quotas = vec![LANE; partitions + 1];
    quotas[OWN] = OWN_LANE;
    quotas
}

/// The screen.
pub struct Screen {
    outlet: Arc<Outlet>,
    line_end: &'static str,
    at_line_start: bool,
    /// By partition.
    budgets: Vec<Budget>,
    /// What was told of each partition's losses, and of Takt's own behind them.
    told: Vec<Told>,
    /// Bytes of Takt's own lines that found no room.
    own_dropped: u64,
    /// When the reader was last seen to read, or to have nothing to.
    read: (u64, Instant),
    now: Instant,
}

#[derive(Clone, Copy)]
struct Told {
    bytes: u64,
    at: Option<Instant>,
}

impl Screen {
    /// The screen behind an outlet with the [`quotas`] of so many partitions; `raw` says that the terminal
    /// does not add carriage returns by itself.
    #[must_use]
    pub fn new(outlet: Arc<Outlet>, raw: bool, partitions: usize) -> Self {
        let now = Instant::now();
        Self {
            outlet,
            line_end: if raw { "\r\n" } else { "\n" },
            at_line_start: true,
            budgets: vec![Budget::FULL; partitions],
            told: vec![Told { bytes: 0, at: None }; partitions + 1],
            own_dropped: 0,
            read: (0, now),
            now,
        }
    }

    /// To be told the time, some times a second: budgets grow with it.
    pub fn tick(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.now);
        self.budgets.iter_mut().for_each(|budget| budget.grow(passed));
        self.now = now;
        let written = self.outlet.written();
        if written != self.read.0 || self.outlet.waiting() == 0 {
            self.read = (written, now);
        }
    }

    /// How much to take from a partition that waits for room, so that nothing of it is dropped: all,
    /// once the reader has stopped.
    #[must_use]
    pub fn allowance(&self, partition: PartitionId) -> Allowance {
        if self.now.saturating_duration_since(self.read.1) > PATIENCE {
            return Allowance::ALL;
        }
        let left = self.budget(partition);
        Allowance { bytes: left.bytes.min(self.outlet.room(lane(partition))), ..left }
    }

    /// What is left of a partition's budget, for one that is not shown here.
    #[must_use]
    pub fn budget(&self, partition: PartitionId) -> Allowance {
        self.budgets.get(partition.0).map_or(Allowance::ALL, Budget::left)
    }

    /// Takes from a partition's budget what it has written elsewhere.
    pub fn spend(&mut self, partition: PartitionId, bytes: &[u8]) {
        if let Some(budget) = self.budgets.get_mut(partition.0) {
            budget.spend(bytes);
        }
    }

    /// Shows what a guest wrote, unchanged, or the beginning of it. Returns how many bytes were dropped.
    pub fn raw(&mut self, partition: PartitionId, bytes: &[u8]) -> u64 {
        let Some(budget) = self.budgets.get_mut(partition.0) else { return bytes.len() as u64 };
        let left = budget.left();
        let room = left.bytes.min(self.outlet.room(lane(partition)));
        let shown = Allowance { bytes: room, ..left }.of(bytes);
        let (shown, dropped) = bytes.split_at_checked(shown).unwrap_or((bytes, &[]));
        if let Some(last) = shown.last()
            && self.outlet.push(lane(partition), shown).is_ok()
        {
            budget.spend(shown);
            self.at_line_start = matches!(last, b'\n' | b'\r');
            return dropped.len() as u64;
        }
        bytes.len() as u64
    }

    /// Shows one line of a partition's, with its name in front. Returns how many bytes were dropped: all
    /// of the text, or none.
    pub fn guest_line(&mut self, partition: PartitionId, name: &str, text: &str) -> u64 {
        let line = self.format(name, text);
        let is_left = self.budgets.get(partition.0).is_some_and(|budget| budget.has(&line));
        if !is_left || self.outlet.push(lane(partition), &line).is_err() {
            return text.len() as u64;
        }
        if let Some(budget) = self.budgets.get_mut(partition.0) {
            budget.spend(&line);
        }
        self.at_line_start = true;
        0
    }

    /// Shows one line of Takt's own, with `author` in front.
    pub fn line(&mut self, author: &str, text: &str) {
        let line = self.format(author, text);
        if self.outlet.push(OWN, &line).is_ok() {
            self.at_line_start = true;
        } else {
            self.own_dropped += line.len() as u64;
        }
    }

    fn format(&self, author: &str, text: &str) -> Vec<u8> {
        let start = if self.at_line_start { "" } else { self.line_end };
        format!("{start}[{author}] {text}{}", self.line_end).into_bytes()
    }

    /// Says how much of a partition was dropped, if it is more than was said before, of which `dropped` is
    /// the sum; now and then, and only when there is room again.
    pub fn tell_losses(&mut self, partition: PartitionId, name: &str, dropped: u64) {
        self.tell(partition.0, lane(partition), name, dropped);
    }

    /// As [`tell_losses`](Self::tell_losses), of Takt's own lines.
    pub fn tell_own_losses(&mut self) {
        self.tell(self.budgets.len(), OWN, "takt", self.own_dropped);
    }

    /// Says at once what has not been said: the run is over.
    pub fn tell_last_losses<'a>(&mut self, all: impl Iterator<Item = (&'a str, u64)>) {
        for (index, (name, dropped)) in all.enumerate() {
            self.told[index].at = None;
            self.tell(index, OWN, name, dropped);
        }
        let own = self.budgets.len();
        self.told[own].at = None;
        self.tell_own_losses();
    }

    fn tell(&mut self, index: usize, lane: usize, name: &str, dropped: u64) {
        let Some(told) = self.told.get(index).copied() else { return };
        let fresh = dropped.saturating_sub(told.bytes);
        let recently =
            told.at.is_some_and(|at| self.now.saturating_duration_since(at) < TOLD_EVERY);
        // Room for one more of the longest lines, so that it flows and does not only drip.
        let flows = self.outlet.room(lane) >= OWN_LANE / 2;
        if fresh == 0 || recently || !flows {
            return;
        }
        let before = self.own_dropped;
        self.line("takt", &format!("console: {fresh} bytes of {name} dropped"));
        if self.own_dropped == before {
            self.told[index] = Told { bytes: dropped, at: Some(self.now) };
        }
    }

    /// Bytes of Takt's own lines that found no room.
    #[must_use]
    pub fn own_dropped(&self) -> u64 {
        self.own_dropped
    }
}

#[cfg(test)]
mod tests;
