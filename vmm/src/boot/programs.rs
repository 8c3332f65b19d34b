//! The programs of a PLC, in its memory.
//!
//! Their images were read and checked with the partition file, and their places fixed. Here they are only
//! copied, at the first start and at every later one: a guest may have written anything over them.

use takt_abi::program::ProgramTable;
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress, GuestMemoryError};

use crate::config::{Partition, Program, program_table};
use crate::memory::GuestMemory;

/// A program that could not be copied into its guest's memory.
#[derive(Debug, Error)]
#[error("the program {name} cannot be loaded: {source}")]
pub struct ProgramError {
    name: String,
    source: GuestMemoryError,
}

/// The programs of a partition, of which there is at least one.
#[derive(Clone)]
pub struct Programs {
    programs: Vec<Program>,
    table: ProgramTable,
}

impl Programs {
    /// Those of a partition, if it has any.
    #[must_use]
    pub fn of(partition: &Partition) -> Option<Self> {
        let programs = partition.programs().to_vec();
        let table = program_table(&programs, partition.memory_bytes())?;
        Some(Self { programs, table })
    }

    /// What the guest is told of them.
    #[must_use]
    pub fn table(&self) -> ProgramTable {
        self.table
    }

    /// Copies the images into memory that is zero.
    ///
    /// # Errors
    /// If one does not lie in the memory, which the partition file's checks have ruled out.
    pub fn load(&self, memory: &GuestMemory) -> Result<(), ProgramError> {
        self.programs.iter().try_for_each(|program| {
            let to = GuestAddress(program.place.image);
            let copied = memory.regions().write_slice(program.bytes(), to);
            copied.map_err(|source| ProgramError { name: program.name.clone(), source })
        })
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
    use takt_program::build::{Builder, Task};
    use takt_program::{CodeOffset, Nanoseconds};

    const FILE: &str = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"a.plc\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";

    /// A partition with one program.
    fn partition() -> Partition {
        let folder = PathBuf::from(env!("OUT_DIR")).join("programs");
        fs::create_dir_all(&folder).unwrap();
        let mut image = Builder::new("a");
        image.code = vec![0xc3];
        let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
        task.budget = Some(Nanoseconds(10_000));
        image.task(task);
        fs::write(folder.join("a.plc"), image.build().unwrap()).unwrap();
        fs::write(folder.join("case.toml"), FILE).unwrap();
        config::load(&folder.join("case.toml"), None).unwrap().partitions()[0].clone()
    }

    #[test]
    fn a_start_finds_its_programs_whole_whatever_the_guest_before_has_done() {
        let partition = partition();
        let programs = Programs::of(&partition).unwrap();
        let (bytes, image) = (partition.memory_bytes(), programs.table().programs[0]);
        let memory = GuestMemory::for_plc_with_programs(bytes, Pages::Small, &[]).unwrap();
        let guest = PlcImage::read(Source::Kernel, bytes).unwrap();
        guest.load(&memory).unwrap();
        for mode in [StartMode::Cold, StartMode::Warm] {
            programs.load(&memory).unwrap();
            let mut found = vec![0; image.image_bytes as usize];
            memory.regions().read_slice(&mut found, GuestAddress(image.image)).unwrap();
            assert_eq!(found, partition.programs()[0].bytes());
            for place in [image.image, image.second_bank, image.state, programs.table().work] {
                let at = GuestAddress(place);
                memory.regions().write_obj(7u64, at).unwrap();
            }
            guest.reload(&memory, mode).unwrap();
            let at = GuestAddress(image.second_bank);
            assert_eq!(memory.regions().read_obj::<u64>(at).unwrap(), 0);
        }
    }
}
