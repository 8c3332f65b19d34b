//! One major frame of one CPU, drawn.

use std::fmt::Write;

use takt_scheduler::table::{Cpu, Role, Table, Window};
use takt_scheduler::time::Nanos;

use super::line;
use crate::{Partition, PartitionFile};

/// Width of the timeline in characters; a multiple of the ticks of its axis.
const WIDTH: u64 = 64;
const TICKS: u64 = 4;

/// Draws the partitions of a CPU under one schedule, each in a row.
pub fn draw(out: &mut String, file: &PartitionFile, table: &Table, cpu: Cpu) {
    let margin = file.partitions().iter().map(|p| p.name().len()).max().unwrap_or(0);
    let gap = (WIDTH / TICKS) as usize;
    let (mut labels, mut ticks) = (String::new(), String::new());
    for tick in 0..=TICKS {
        let _ = write!(labels, "{:gap$}", Nanos(table.frame().0 * tick / TICKS));
        let _ = write!(ticks, "{:gap$}", "|");
    }
    line(out, &format!("\nCPU {}", cpu.0));
    line(out, &format!("  {:margin$}  {labels}", ""));
    line(out, &format!("  {:margin$}  {ticks}", ""));
    for partition in file.partitions().iter().filter(|p| p.cpus().any(|own| own == cpu)) {
        let row: String = (0..WIDTH).map(|column| cell(table, partition, cpu, column)).collect();
        line(out, &format!("  {:margin$}  {row}", partition.name()));
    }
}

/// What a partition does in one column. A window or a guard shows in every column that it touches,
/// so that none is too short to be seen; the background gets the columns that it has mostly.
fn cell(table: &Table, partition: &Partition, cpu: Cpu, column: u64) -> char {
    let frame = table.frame().0;
    let (from, to) = (frame * column / WIDTH, frame * (column + 1) / WIDTH);
    match table.placements()[partition.id().0].role {
        Role::Windowed { .. } => {
            let own = || table.windows_of(partition.id());
            if own().any(|w| shared(from, to, w.offset.0, w.end().0) > 0) {
                '#'
            } else if own().any(|w| guard_in(table, w, from, to) > 0) {
                '<'
            } else {
                ' '
            }
        }
        Role::Background => {
            let taken: u64 = table
                .windows_on(cpu)
                .map(|w| shared(from, to, w.offset.0, w.end().0) + guard_in(table, w, from, to))
                .sum();
            if taken * 2 < to - from { '-' } else { ' ' }
        }
    }
}

/// Nanoseconds that two spans have in common.
fn shared(from: u64, to: u64, start: u64, end: u64) -> u64 {
    to.min(end).saturating_sub(from.max(start))
}

/// Nanoseconds of a window's guard between `from` and `to`. A guard that starts before the frame
/// lies at the end of the frame before.
fn guard_in(table: &Table, window: &Window, from: u64, to: u64) -> u64 {
    let Role::Windowed { guard } = table.placements()[window.partition.0].role else { return 0 };
    let (frame, start) = (table.frame().0, window.offset.0);
    let wrapped = guard.0.saturating_sub(start);
    shared(from, to, start.saturating_sub(guard.0), start)
        + shared(from, to, frame.saturating_sub(wrapped), frame)
}
