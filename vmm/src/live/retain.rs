//! The retained values of the programs of one partition, on their way from the kernel to the next start.
//!
//! They are looked at as a client looks at values: the kernel copies all of a program's between two jobs. A copy that
//! was made while the program was in the middle of something is not taken. The newest one is what a warm start of
//! the guest finds, and what is written to the program's file.

use std::sync::Arc;

use takt_abi::live::{Area, Range};
use takt_program::Image;
use takt_retain::Layout;
use takt_scheduler::time::Nanos;

use super::change::{Banks, ProgramChanges};
use super::limits::ProgramLimits;
use super::watching::{OWN_CLIENTS, Sampled, Watching};
use crate::boot::retained::Kept;
use crate::config::Program;
use crate::saver::{FileNumber, Saver};

/// How often the values are copied.
const INTERVAL: Nanos = Nanos::from_millis(100);
/// When it is told that there are no values, or that they are not written.
const PATIENCE: Nanos = Nanos::from_millis(10_000);
/// How much of the time without values a window counts at most: while a PLC has no windows, there is nothing to copy.
const EACH_WINDOW: Nanos = Nanos::from_millis(2_500);

/// All programs of a partition.
#[derive(Default)]
pub struct Retaining {
    programs: Vec<Keeper>,
    /// Windows that the partition has had, and when that was seen.
    windows: (u64, Nanos),
}

/// What is kept of one program.
struct Keeper {
    name: String,
    layout: Arc<Layout>,
    watches: bool,
    /// Time with windows since values came last, or were first to come.
    unseen: Nanos,
    told_unseen: bool,
    /// Cycle and values.
    newest: Option<(u64, Vec<u8>)>,
    file: Option<Written>,
}

/// What is known of a file.
struct Written {
    number: FileNumber,
    every: Nanos,
    /// When the next generation is due.
    due: Nanos,
    /// Since when one is on its way.
    since: Option<Nanos>,
    told_late: bool,
    failed: bool,
    /// The values that were handed over last.
    handed: Vec<u8>,
}

impl Retaining {
    /// Those of a partition; `file` gives the file of each.
    pub fn of(programs: &[Program], file: impl Fn(usize) -> Option<FileNumber>) -> Self {
        let keeper = |(place, program): (usize, &Program)| {
            let layout = program.image().map(|image| Layout::of(&image)).unwrap_or_default();
            let written = file(place).zip(program.retain.as_ref()).map(|(number, file)| Written {
                number,
                every: file.every,
                due: Nanos::ZERO,
                since: None,
                told_late: false,
                failed: false,
                handed: Vec::new(),
            });
            Keeper {
                name: program.name.clone(),
                layout: layout.into(),
                watches: false,
                unseen: Nanos::ZERO,
                told_unseen: false,
                newest: None,
                file: written,
            }
        };
        let programs = programs.iter().enumerate().map(keeper).collect();
        Self { programs, ..Self::default() }
    }

    fn keeper(&mut self, client: u64) -> Option<(usize, &mut Keeper)> {
        let place = usize::try_from(client.checked_sub(OWN_CLIENTS)?).ok()?;
        Some((place, self.programs.get_mut(place)?))
    }

    /// Takes values, if they are of a program's own. Gives them back if not.
    pub fn take(&mut self, sampled: Sampled, banks: Option<&Banks>) -> Option<Sampled> {
        let Some((place, keeper)) = self.keeper(sampled.client) else { return Some(sampled) };
        let settled = sampled.head.unsettled & 1 << place == 0;
        if settled && keeper.watches && sampled.bytes.len() == keeper.layout.initial().len() {
            (keeper.unseen, keeper.told_unseen) = (Nanos::ZERO, false);
            if let Some(banks) = banks {
                let (layout, block) = (keeper.layout.clone(), sampled.bytes.clone());
                banks.programs.keep(place, Kept { layout, block, retain: true });
            }
            keeper.newest = Some((sampled.head.cycle, sampled.bytes));
        }
        None
    }

    /// A watch has ended. True if it was one of these.
    pub fn left(&mut self, client: u64) -> bool {
        let keeper = self.keeper(client);
        keeper.map(|(_, keeper)| keeper.watches = false).is_some()
    }

    /// A program runs another version. What is known of its values is of the one before, until there are new ones.
    pub fn entered(&mut self, place: usize, image: &Image<'_>) {
        let Some(keeper) = self.programs.get_mut(place) else { return };
        if keeper.layout.image() != image.hash() {
            keeper.layout = Layout::of(image).into();
            (keeper.watches, keeper.told_unseen, keeper.newest) = (false, false, None);
            // Values that are the same byte by byte are another version's all the same.
            keeper.file.iter_mut().for_each(|file| file.handed.clear());
        }
    }

    /// The guest has had a cold start: until there are new values they are those that it began with, also in the file.
    pub fn started_cold(&mut self) {
        for keeper in &mut self.programs {
            let Some((_, block)) = &mut keeper.newest else { continue };
            if let Some(cold) = keeper.layout.cold(block) {
                *block = cold;
            }
            keeper.file.iter_mut().for_each(|file| file.due = Nanos::ZERO);
        }
    }

    /// Has the values copied that are not, where places in the program can be relied on.
    pub fn watch(
        &mut self,
        watching: &mut Watching,
        limits: &[ProgramLimits],
        changes: &ProgramChanges,
        news: &mut Vec<String>,
    ) {
        for (place, keeper) in (0u8..).zip(&mut self.programs) {
            if keeper.watches || changes.is_settled(place).is_err() {
                continue;
            }
            let client = OWN_CLIENTS + u64::from(place);
            let range = |(offset, bytes): (u32, u32)| {
                let bytes = u16::try_from(bytes).unwrap_or(u16::MAX);
                Range { program: place, area: Area::State, offset, bytes }
            };
            let ranges = keeper.layout.variables().map(range).collect();
            match watching.watch(client, ranges, INTERVAL, limits) {
                Ok(_) => {
                    (keeper.watches, keeper.unseen, keeper.told_unseen) =
                        (true, Nanos::ZERO, false);
                }
                // Others have taken the room while a change went on. It is tried again until they have gone.
                Err(text) if !keeper.told_unseen => {
                    keeper.told_unseen = true;
                    news.push(format!("{}: its values are not retained: {text}", keeper.name));
                }
                Err(_) => {}
            }
        }
    }

    /// Hands over what is to be written, and says what is not as it should be. The partition has had so many windows.
    pub fn save(
        &mut self,
        saver: Option<&mut Saver>,
        windows: u64,
        now: Nanos,
        news: &mut Vec<String>,
    ) {
        let mut passed = Nanos::ZERO;
        if windows != self.windows.0 {
            passed = now.less(self.windows.1).min(EACH_WINDOW);
            self.windows = (windows, now);
        }
        for keeper in &mut self.programs {
            keeper.unseen = keeper.unseen.plus(passed);
            let waits = keeper.unseen > PATIENCE;
            if keeper.watches && waits && !keeper.told_unseen && !keeper.layout.is_empty() {
                keeper.told_unseen = true;
                let name = &keeper.name;
                news.push(format!(
                    "{name}: for 10 s there was no moment between two cycles at which its values could be copied, or a job was \
                     ended in the middle and none of its task has been complete since: a warm start finds older ones"
                ));
            }
        }
        let Some(saver) = saver else { return };
        for keeper in &mut self.programs {
            keeper.write(saver, now, false);
            let Some(file) = &mut keeper.file else { continue };
            let late = file.since.is_some_and(|since| now.0.saturating_sub(since.0) > PATIENCE.0);
            if late && !file.told_late {
                file.told_late = true;
                let name = &keeper.name;
                news.push(format!("{name}: for 10 s the disk has not taken its retained values"));
            }
        }
    }

    /// Hands over what has not been, since the run ends.
    pub fn save_last(&mut self, saver: &mut Saver, now: Nanos) {
        self.programs.iter_mut().for_each(|keeper| keeper.write(saver, now, true));
    }

    /// What came of something that was handed over; gives it back if it is another partition's.
    pub fn outcome(
        &mut self,
        number: FileNumber,
        result: &std::io::Result<u64>,
        news: &mut Vec<String>,
    ) {
        let is_it = |keeper: &&mut Keeper| keeper.file.as_ref().is_some_and(|f| f.number == number);
        let Some(keeper) = self.programs.iter_mut().find(is_it) else { return };
        let Some(file) = &mut keeper.file else { return };
        let name = &keeper.name;
        (file.since, file.told_late) = (None, false);
        match result {
            Ok(generation) if file.failed => {
                file.failed = false;
                news.push(format!(
                    "{name}: its retained values are written again: generation {generation}"
                ));
            }
            Ok(_) => {}
            Err(error) => {
                // Written again with the next turn that is due, whether or not they change.
                file.handed.clear();
                if !file.failed {
                    file.failed = true;
                    news.push(format!("{name}: its retained values cannot be written: {error}"));
                }
            }
        }
    }
}

impl Keeper {
    fn write(&mut self, saver: &mut Saver, now: Nanos, last: bool) {
        let (Some(file), Some((cycle, block))) = (&mut self.file, &self.newest) else { return };
        let due = now >= file.due || last;
        let waits = file.since.is_some() && !last;
        if !due || waits || *block == file.handed || self.layout.is_empty() {
            return;
        }
        if saver.save(file.number, *cycle, self.layout.clone(), block.clone()) {
            (file.since, file.due) = (Some(now), now.plus(file.every));
            file.handed.clone_from(block);
        }
    }
}

#[cfg(test)]
#[path = "retain_tests.rs"]
mod tests;
