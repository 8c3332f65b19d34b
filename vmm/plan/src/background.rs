//! How background partitions share a CPU.
//!
//! What windows leave goes to the host's ordinary scheduler, which gives each thread that wants to run the same, over
//! some milliseconds. A Linux has a thread for its processor, one for each disk and one for each network interface.
//! So a Linux whose processor alone is busy has at least one part in as many as there are threads of all Linuxes on its
//! CPU, less its own other ones.

use takt_scheduler::table::{Cpu, PartitionId, Role, Table};
use takt_scheduler::time::Nanos;

use super::{Partition, PartitionFile};

impl Partition {
    /// Threads of the ordinary class that it keeps busy at most.
    #[must_use]
    pub fn background_threads(&self) -> u64 {
        1 + (self.disks.len() + self.nets.len()) as u64
    }
}

impl PartitionFile {
    /// Time per frame that a partition has under a schedule, whatever the others do; of one in the background over
    /// many frames.
    #[must_use]
    pub fn own_time(&self, table: &Table, partition: PartitionId) -> Nanos {
        let whole = table.guaranteed(partition);
        let placement = table.placements()[partition.0];
        match placement.role {
            Role::Windowed { .. } => whole,
            Role::Background => Nanos(whole.0 / (1 + self.rivals(table, placement.cpu, partition))),
        }
    }

    /// The least of these times in any schedule.
    #[must_use]
    pub fn least_own_time(&self, partition: PartitionId) -> Nanos {
        let times = self.schedules.tables().iter().map(|t| self.own_time(t, partition));
        times.min().unwrap_or(Nanos::ZERO)
    }

    /// Threads of others that want what the windows of a CPU leave.
    fn rivals(&self, table: &Table, cpu: Cpu, partition: PartitionId) -> u64 {
        let others = table.backgrounds_of(cpu).filter(|id| *id != partition);
        others.map(|id| self.partitions[id.0].background_threads()).sum()
    }
}
