//! The programs of a PLC, in its memory.
//!
//! Their images were read and checked with the partition file, and their places fixed. Here they are only
//! copied, at the first start and at every later one: a guest may have written anything over them.

use std::mem;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use takt_abi::program::ProgramTable;
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress, GuestMemoryError};

use super::StartMode;
use super::retained::Kept;
use crate::config::{Partition, Program, program_table};
use crate::memory::GuestMemory;

/// A program that could not be copied into its guest's memory.
#[derive(Debug, Error)]
#[error("the program {name} cannot be loaded: {source}")]
pub struct ProgramError {
    name: String,
    source: GuestMemoryError,
}

/// For each program, the image that has taken the place of that of the file.
type Changed = Vec<Option<Arc<[u8]>>>;

/// The programs of a partition, of which there is at least one.
#[derive(Clone)]
pub struct Programs {
    programs: Vec<Program>,
    table: ProgramTable,
    starts: Arc<Mutex<Starts>>,
}

/// What the thread that loads a guest and the one that changes its programs share.
#[derive(Default)]
struct Starts {
    /// How often the guest has begun to start anew.
    count: u64,
    /// What it starts with the next time.
    next: Changed,
    /// What it was loaded with the last time.
    loaded: Changed,
    /// What each program retains, once that is known.
    kept: Vec<Option<Kept>>,
    /// The guest has been loaded for a cold start, and has yet to be seen.
    cold: bool,
}

impl Programs {
    /// Those of a partition, if it has any.
    #[must_use]
    pub fn of(partition: &Partition) -> Option<Self> {
        let programs = partition.programs().to_vec();
        let table = program_table(&programs, partition.memory_bytes())?;
        let none = vec![None; programs.len()];
        let kept = vec![None; programs.len()];
        let starts = Starts { next: none.clone(), loaded: none, kept, ..Starts::default() };
        Some(Self { programs, table, starts: Arc::new(Mutex::new(starts)) })
    }

    fn starts(&self) -> MutexGuard<'_, Starts> {
        self.starts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The guest begins to start anew: from now on only its loader writes to its memory.
    pub fn begin_start(&self) {
        self.starts().count += 1;
    }

    /// How often the guest has begun to start anew.
    #[must_use]
    pub fn start_count(&self) -> u64 {
        self.starts().count
    }

    /// Writes to the memory of the guest that runs, which must not begin to start anew meanwhile. `None` if it has
    /// begun to since `count` was true.
    pub fn write<R>(&self, count: u64, write: impl FnOnce() -> R) -> Option<R> {
        let starts = self.starts();
        (starts.count == count).then(write)
    }

    /// All of them, in the order of the file.
    #[must_use]
    pub fn all(&self) -> &[Program] {
        &self.programs
    }

    /// From now on the guest starts with this image of a program; with that of the file, if none is given.
    pub fn start_with(&self, place: usize, image: Option<Arc<[u8]>>) {
        if let Some(slot) = self.starts().next.get_mut(place) {
            *slot = image;
        }
    }

    /// The image that the guest was loaded with; `None` if it was that of the file.
    #[must_use]
    pub fn loaded(&self, place: usize) -> Option<Arc<[u8]>> {
        self.starts().loaded.get(place).cloned().flatten()
    }

    /// From now on a program that starts anew has these values. Waits for nothing: while the guest is being loaded they are
    /// dropped, and newer ones come when it runs. So are those from before a cold start whose guest has yet to be seen.
    pub fn keep(&self, place: usize, kept: Kept) {
        let mut starts = match self.starts.try_lock() {
            Ok(starts) => starts,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        if !starts.cold
            && let Some(slot) = starts.kept.get_mut(place)
        {
            *slot = Some(kept);
        }
    }

    /// The guest has been seen after a start: from now on there are values of its own. True if there was a cold start since
    /// the last time.
    #[must_use]
    pub fn was_seen(&self) -> bool {
        mem::take(&mut self.starts().cold)
    }

    /// Copies the images into memory that is zero, and what the programs retain over such a start. Returns what the guest is
    /// told of them.
    ///
    /// # Errors
    /// If one does not lie in the memory, which the partition file's checks have ruled out.
    pub fn load(
        &self,
        memory: &GuestMemory,
        mode: StartMode,
    ) -> Result<ProgramTable, ProgramError> {
        let mut starts = self.starts();
        starts.loaded = starts.next.clone();
        if mode == StartMode::Cold {
            // A warm start may follow before there are newer ones.
            starts.cold = true;
            starts.kept.iter_mut().flatten().for_each(|kept| kept.retain = false);
        }
        let mut table = self.table;
        let entries = table.programs.iter_mut().zip(&self.programs).zip(&starts.loaded);
        for (((entry, program), changed), kept) in entries.zip(&starts.kept) {
            let image = changed.as_deref().unwrap_or(program.bytes());
            entry.image_bytes = image.len() as u64;
            let failed = |source| ProgramError { name: program.name.clone(), source };
            let write = |bytes: &[u8], at| memory.regions().write_slice(bytes, GuestAddress(at));
            write(image, program.place.image).map_err(failed)?;
            let beginning = kept.as_ref().map(|kept| kept.beginning(image, mode));
            if let Some((restored, block)) = beginning
                && block.len() as u64 <= entry.retained_bytes
            {
                entry.restored = restored;
                write(&block, entry.retained).map_err(failed)?;
            }
        }
        Ok(table)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use super::*;
    use crate::boot::StartMode;
    use crate::boot::plc::{PlcImage, Source};
    use crate::config;
    use crate::memory::Pages;
    use takt_abi::program::restored;
    use takt_program::build::{Builder, Task, Variable};
    use takt_program::{Area, CodeOffset, Elementary, Flags, Nanoseconds};
    use takt_retain::Layout;

    const FILE: &str = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"a.plc\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";

    /// A partition with one program.
    fn partition(folder: &str) -> Partition {
        let folder = PathBuf::from(env!("OUT_DIR")).join("programs").join(folder);
        fs::create_dir_all(&folder).unwrap();
        let mut image = Builder::new("a");
        image.code = vec![0xc3];
        image.state_bytes = 16;
        let ty = image.elementary(Elementary::Ulint);
        for (name, at, flag) in [("a", 0, Flags::RETAIN), ("b", 8, Flags::PERSISTENT)] {
            image.variable(Variable::new(name, ty, Area::State, at).with(flag));
        }
        let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
        task.budget = Some(Nanoseconds(10_000));
        image.task(task);
        fs::write(folder.join("a.plc"), image.build().unwrap()).unwrap();
        fs::write(folder.join("case.toml"), FILE).unwrap();
        config::load(&folder.join("case.toml"), None).unwrap().partitions()[0].clone()
    }

    #[test]
    fn a_start_finds_its_programs_whole_whatever_the_guest_before_has_done() {
        let partition = partition("whole");
        let programs = Programs::of(&partition).unwrap();
        let (bytes, image) = (partition.memory_bytes(), programs.table.programs[0]);
        let memory = GuestMemory::for_plc_with_programs(bytes, Pages::Small, &[]).unwrap();
        let guest = PlcImage::read(Source::Kernel, bytes).unwrap();
        guest.load(&memory).unwrap();
        for mode in [StartMode::Cold, StartMode::Warm] {
            programs.load(&memory, StartMode::Cold).unwrap();
            let mut found = vec![0; image.image_bytes as usize];
            memory.regions().read_slice(&mut found, GuestAddress(image.image)).unwrap();
            assert_eq!(found, partition.programs()[0].bytes());
            for place in [image.image, image.second_bank, image.state, programs.table.work] {
                let at = GuestAddress(place);
                memory.regions().write_obj(7u64, at).unwrap();
            }
            guest.reload(&memory, mode).unwrap();
            let at = GuestAddress(image.second_bank);
            assert_eq!(memory.regions().read_obj::<u64>(at).unwrap(), 0);
        }
    }

    #[test]
    fn a_start_finds_the_version_that_was_entered_last() {
        let partition = partition("version");
        let programs = Programs::of(&partition).unwrap();
        let memory =
            GuestMemory::for_plc_with_programs(partition.memory_bytes(), Pages::Small, &[])
                .unwrap();
        let other: Arc<[u8]> = vec![7; 9000].into();
        // What is said of one is true of its copies: one starts the guest, another follows its changes.
        programs.clone().start_with(0, Some(other.clone()));
        let place = programs.load(&memory, StartMode::Cold).unwrap().programs[0];
        assert_eq!(place.image_bytes, 9000);
        let mut found = vec![0; 9000];
        memory.regions().read_slice(&mut found, GuestAddress(place.image)).unwrap();
        assert_eq!(found, &other[..]);
        assert_eq!(programs.loaded(0), Some(other));
        programs.start_with(0, None);
        let bytes = partition.programs()[0].bytes().len() as u64;
        assert_eq!(programs.load(&memory, StartMode::Cold).unwrap().programs[0].image_bytes, bytes);
        assert_eq!(programs.loaded(0), None);
    }

    #[test]
    fn a_warm_start_brings_back_nothing_from_before_a_cold_one() {
        let partition = partition("cold");
        let programs = Programs::of(&partition).unwrap();
        let memory =
            GuestMemory::for_plc_with_programs(partition.memory_bytes(), Pages::Small, &[])
                .unwrap();
        let layout = Arc::new(Layout::of(&partition.programs()[0].image().unwrap()));
        let keep = || {
            let kept = Kept { layout: layout.clone(), block: vec![1; 16], retain: true };
            programs.keep(0, kept);
        };
        let begins = |mode| {
            let entry = programs.load(&memory, mode).unwrap().programs[0];
            let mut block = [0; 16];
            memory.regions().read_slice(&mut block, GuestAddress(entry.retained)).unwrap();
            (entry.restored, block.map(|byte| byte == 1))
        };
        let persistent: [bool; 16] = std::array::from_fn(|at| at >= 8);
        keep();
        assert_eq!(begins(StartMode::Warm), (restored::ALL, [true; 16]));
        assert!(!programs.was_seen());
        assert_eq!(begins(StartMode::Cold), (restored::PERSISTENT, persistent));
        assert_eq!(begins(StartMode::Warm), (restored::PERSISTENT, persistent));
        // Values that were on their way when the guest ended.
        keep();
        assert_eq!(begins(StartMode::Warm), (restored::PERSISTENT, persistent));
        assert!(programs.was_seen() && !programs.was_seen());
        keep();
        assert_eq!(begins(StartMode::Warm), (restored::ALL, [true; 16]));
    }

    #[test]
    fn a_guest_that_starts_anew_is_written_to_by_its_loader_only() {
        let programs = Programs::of(&partition("starts")).unwrap();
        let count = programs.start_count();
        assert_eq!(programs.write(count, || 7), Some(7));
        programs.clone().begin_start();
        assert_eq!(programs.write(count, || panic!("the guest starts")), None::<()>);
        assert_eq!(programs.write(programs.start_count(), || 7), Some(7));
    }
}
