//! How background partitions share a CPU.
//!
//! What windows leave goes to the host's ordinary scheduler, which gives each thread that wants to run the same, over
//! some milliseconds. A Linux has a thread for each of its processors, on the CPU of that, and on its first CPU one for
//! each disk, one for each network interface and one for its sockets. So a processor that is busy, of a Linux that does nothing else, has at
//! least one part in as many as there are threads of all Linuxes on its CPU, less its own Linux's other ones. A Linux with windows has a
//! thread there too, beside those of its disks: the one that makes it new.

use takt_scheduler::table::{Cpu, PartitionId, Role, Table};
use takt_scheduler::time::Nanos;

use super::{Kind, Partition, PartitionFile};

impl Partition {
    /// Threads of the ordinary class that it keeps busy at most on one of its CPUs: its processor's, or with windows the one
    /// that makes it new, and those of its devices.
    #[must_use]
    pub fn background_threads(&self, cpu: Cpu) -> u64 {
        let devices = self.disks.len() + self.nets.len() + usize::from(self.vsock.is_some());
        1 + if cpu == self.cpu { devices as u64 } else { 0 }
    }
}

impl PartitionFile {
    /// Time per frame that a partition has under a schedule, whatever the others do; of one in the background over
    /// many frames, on all of its CPUs together.
    #[must_use]
    pub fn own_time(&self, table: &Table, partition: PartitionId) -> Nanos {
        match table.placements()[partition.0].role {
            Role::Windowed { .. } => table.guaranteed(partition),
            Role::Background => table
                .processors_of(partition)
                .fold(Nanos::ZERO, |sum, cpu| sum.plus(self.own_time_on(table, partition, cpu))),
        }
    }

    /// The part of [`own_time`](Self::own_time) that a background partition has on one of its CPUs.
    #[must_use]
    pub fn own_time_on(&self, table: &Table, partition: PartitionId, cpu: Cpu) -> Nanos {
        let others = self.partitions.iter().filter(|it| it.id != partition);
        let linuxes = others.filter(|it| matches!(it.kind, Kind::Linux { .. }));
        let here = linuxes.filter(|it| it.cpus().any(|own| own == cpu));
        let rivals: u64 = here.map(|it| it.background_threads(cpu)).sum();
        Nanos(table.left_on(cpu).0 / (1 + rivals))
    }

    /// The least of these times in any schedule.
    #[must_use]
    pub fn least_own_time(&self, partition: PartitionId) -> Nanos {
        let times = self.schedules.tables().iter().map(|t| self.own_time(t, partition));
        times.min().unwrap_or(Nanos::ZERO)
    }
}
