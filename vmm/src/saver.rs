//! Files for the retained values of programs: read before anything runs, written by a thread of their own.
//!
//! A disk may take seconds to make a write durable. So neither a PLC's thread nor the supervisor thread writes:
//! the supervisor thread hands a copy of the values over and goes on, and hears later what came of it. A program
//! has one copy on its way at a time; newer values wait where they are, and only the newest are written.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use takt_retain::{Layout, Store};
use thiserror::Error;

use crate::boot::retained::Kept;
use crate::config::{Partition, PartitionFile, Program};
use crate::handoff::{Giver, Taker, handoff};
use crate::sandbox::Kind;
use crate::vcpu::thread::{Spawn, ThreadError};

/// A file that cannot be used.
#[derive(Debug, Error)]
#[error("cannot use the files for the retained values of the program {program}, {}.a and .b: {source}", path.display())]
pub struct SaverError {
    program: String,
    path: PathBuf,
    source: io::Error,
}

/// Number of a file, over all partitions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileNumber(usize);

/// What there was for a program.
#[derive(Debug, Default)]
pub struct Beginning {
    /// Its file, if it has one.
    pub file: Option<FileNumber>,
    /// What it begins with.
    pub kept: Option<Kept>,
    /// What is to be told of that.
    pub news: Vec<String>,
}

/// All files, before they are written to.
#[derive(Default)]
pub struct Files {
    stores: Vec<Store>,
    /// By partition and program.
    beginnings: Vec<Vec<Beginning>>,
}

impl Files {
    /// Opens those of the partition file, and reads what they have.
    ///
    /// # Errors
    /// See [`SaverError`]. What is wrong in a file is told, and is no error.
    pub fn open(file: &PartitionFile) -> Result<Self, SaverError> {
        let mut files = Self::default();
        for partition in file.partitions() {
            let beginnings = partition.programs().iter().map(|program| files.read(program));
            let beginnings = beginnings.collect::<Result<_, _>>()?;
            files.beginnings.push(beginnings);
        }
        Ok(files)
    }

    fn read(&mut self, program: &Program) -> Result<Beginning, SaverError> {
        let (Some(file), Some(image)) = (&program.retain, program.image()) else {
            return Ok(Beginning::default());
        };
        let name = &program.name;
        let (store, found) = Store::open(&file.path).map_err(|source| SaverError {
            program: name.clone(),
            path: file.path.clone(),
            source,
        })?;
        let number = FileNumber(self.stores.len());
        self.stores.push(store);
        let damaged = found.damaged.iter();
        let damaged = damaged.map(|(path, damage)| format!("{name}: {}: {damage}", path.display()));
        let mut news: Vec<String> = damaged.collect();
        let Some(generation) = found.newest else {
            let text = if news.is_empty() {
                "no values were retained yet"
            } else {
                "no generation is whole"
            };
            news.push(format!("{name}: {text}: RETAIN and PERSISTENT have their initial values"));
            return Ok(Beginning { file: Some(number), kept: None, news });
        };
        let layout = Layout::of(&image);
        let restored = layout.restore(&generation);
        let what = if restored.retain { "RETAIN and PERSISTENT" } else { "PERSISTENT" };
        news.push(format!(
            "{name}: {what} values are those of cycle {}, generation {}",
            generation.cycle, generation.number
        ));
        if restored.is_partial() {
            news.push(format!("{name}: {restored}"));
        }
        let kept = Kept { layout: layout.into(), retain: restored.retain, block: restored.block };
        Ok(Beginning { file: Some(number), kept: Some(kept), news })
    }

    /// What a program of a partition begins with.
    #[must_use]
    pub fn beginning(&self, partition: &Partition, program: usize) -> Option<&Beginning> {
        self.beginnings.get(partition.id().0)?.get(program)
    }

    /// Starts the thread that writes, if there is something to write to.
    ///
    /// # Errors
    /// See [`ThreadError`].
    pub fn start(&mut self, spawn: Spawn<'_>) -> Result<Option<Saver>, ThreadError> {
        let stores = std::mem::take(&mut self.stores);
        if stores.is_empty() {
            return Ok(None);
        }
        // One for each file, and the last at the end of the run.
        let (jobs, mut ordered) = handoff::<Job>(2 * stores.len());
        let (mut tell, outcomes) = handoff(2 * stores.len());
        let (ended, end) = channel::<()>();
        let work = move || {
            // Dropped last: who hears of the end finds the files closed and their locks free.
            let _ended = ended;
            let mut stores = stores;
            while let Ok(Some(Job { file, cycle, layout, block })) = ordered.wait(None) {
                let Some(store) = stores.get_mut(file.0) else { continue };
                let _ = tell.give((file, store.save(cycle, &layout, &block)));
            }
        };
        spawn("saver", Kind::Saver, Box::new(work))?;
        Ok(Some(Saver { jobs, outcomes, end }))
    }
}

struct Job {
    file: FileNumber,
    cycle: u64,
    layout: Arc<Layout>,
    block: Vec<u8>,
}

/// The supervisor thread's end of the thread that writes.
pub struct Saver {
    jobs: Giver<Job>,
    outcomes: Taker<(FileNumber, io::Result<u64>)>,
    /// Closed by the thread's end.
    end: Receiver<()>,
}

impl Saver {
    /// Hands values over. A file has one on its way at a time, so there is room.
    pub fn save(
        &mut self,
        file: FileNumber,
        cycle: u64,
        layout: Arc<Layout>,
        block: Vec<u8>,
    ) -> bool {
        self.jobs.give(Job { file, cycle, layout, block }).is_ok()
    }

    /// What came of the next one: the number of its generation.
    pub fn outcome(&mut self) -> Option<(FileNumber, io::Result<u64>)> {
        self.outcomes.take().ok().flatten()
    }

    /// Waits until all is written, but no longer than this.
    ///
    /// # Errors
    /// What kept some of it from being written.
    pub fn finish(self, at_most: Duration) -> io::Result<()> {
        let Self { jobs, mut outcomes, end } = self;
        drop(jobs);
        if end.recv_timeout(at_most) == Err(RecvTimeoutError::Timeout) {
            return Err(io::ErrorKind::TimedOut.into());
        }
        while let Ok(Some((_, result))) = outcomes.take() {
            result?;
        }
        Ok(())
    }
}
