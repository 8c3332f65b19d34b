//! What follows from a partition's errors, where the file has changed it.
//!
//! The default tables are the same for every file and are in `docs/health.md`. What a reader of this
//! one must not overlook is where it departs from them, and whether a watchdog waits for its heartbeat.

use super::line;
use crate::health::{FAULTS, Fault, Table};
use crate::{Kind, Partition, PartitionFile};

/// Rows and limits that differ from the default of their partition's kind; nothing if none does.
pub fn list(out: &mut String, file: &PartitionFile) {
    let mut begun = false;
    for partition in file.partitions() {
        let changes = changes(partition);
        if changes.is_empty() {
            continue;
        }
        if !begun {
            out.push_str("\nhealth monitor, where it is not the default\n");
            begun = true;
        }
        line(out, &format!("  {}", partition.name()));
        for change in changes {
            line(out, &format!("    {change}"));
        }
    }
}

fn changes(partition: &Partition) -> Vec<String> {
    let table = partition.health();
    let default = match partition.kind() {
        Kind::Plc { .. } => Table::PLC,
        Kind::Linux { .. } => Table::LINUX,
    };
    let rows = FAULTS.iter().filter(|fault| **fault != Fault::PartitionSilent);
    let rows = rows.filter(|fault| table.action(**fault) != default.action(**fault));
    let mut changes: Vec<String> =
        rows.map(|fault| format!("{fault} -> {}", table.action(*fault))).collect();
    if let Some(time) = partition.watchdog() {
        let action = table.action(Fault::PartitionSilent);
        changes.push(format!("watchdog: no heartbeat for {time} -> {action}"));
    }
    let limit = table.limit();
    if limit != default.limit() {
        let s = if limit.at_most == 1 { "" } else { "s" };
        changes.push(format!("at most {} start{s} within {}", limit.at_most, limit.within));
    }
    changes
}
