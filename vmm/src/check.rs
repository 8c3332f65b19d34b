//! `takt check`: what a partition file means, before anything is started from it.
//!
//! A schedule is numbers in a file, and what they amount to (who runs when, what is left for the
//! background, what the kernel is asked for) is arithmetic that nobody should do by hand. The
//! timeline is drawn in ASCII, because a machine in a control cabinet is read over a serial line.
//!
//! [`needs`] is the other answer: the same file for a script that starts a machine for it.
//!
//! Both are pure functions of the validated file.

use std::fmt::Write;

use takt_scheduler::reservation::{CEILING_PERMILLE, CpuReservations, Reservation};
use takt_scheduler::table::{Cpu, Role, Table, Window};
use takt_scheduler::time::Nanos;

use crate::config::{Bytes, Kind, Partition, PartitionFile, percent};

/// Width of the timeline in characters; a multiple of the ticks of its axis.
const WIDTH: u64 = 64;
const TICKS: u64 = 4;

/// The schedule drawn per CPU, and a table of what each partition gets. Ends with a newline.
#[must_use]
pub fn report(file: &PartitionFile) -> String {
    let table = file.table();
    let mut out = format!(
        "{}: schedule \"{}\", major frame {}\n",
        file.name(),
        file.schedule_name(),
        table.frame()
    );
    for cpu in table.cpus() {
        timeline(&mut out, file, cpu);
    }
    line(&mut out, "\n# window   < release guard   - background");
    summary(&mut out, file);
    out
}

/// What a machine must have to run the file: the lines `memory BYTES` (the sum of all partitions),
/// `cpus N` (the highest CPU number, plus one), and `file PATH` for the partition file and each
/// image, all absolute. Ends with a newline.
#[must_use]
pub fn needs(file: &PartitionFile) -> String {
    let memory: u64 = file.partitions().iter().map(Partition::memory_bytes).sum();
    let cpus = file.partitions().iter().map(|p| p.cpu().0 + 1).max().unwrap_or(0);
    let mut out = format!("memory {memory}\ncpus {cpus}\nfile {}\n", file.path().display());
    for partition in file.partitions() {
        let images = match partition.kind() {
            Kind::Plc { image } => [image.as_ref(), None],
            Kind::Linux { kernel, initrd, .. } => [Some(kernel), initrd.as_ref()],
        };
        for path in images.into_iter().flatten() {
            line(&mut out, &format!("file {}", path.display()));
        }
    }
    out
}

fn line(out: &mut String, text: &str) {
    out.push_str(text.trim_end());
    out.push('\n');
}

fn timeline(out: &mut String, file: &PartitionFile, cpu: Cpu) {
    let table = file.table();
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
    for partition in file.partitions().iter().filter(|p| p.cpu() == cpu) {
        let row: String = (0..WIDTH).map(|column| cell(table, partition, column)).collect();
        line(out, &format!("  {:margin$}  {row}", partition.name()));
    }
    let reservations = CpuReservations::of(table, cpu);
    if let Some(kicker) = reservations.kicker {
        let text = format!(
            "  reserved: {} of this CPU, of at most {}; {} to end windows",
            percent(reservations.permille()),
            percent(CEILING_PERMILLE),
            words(kicker)
        );
        line(out, &text);
    }
}

/// What a partition does in one column. A window or a guard shows in every column that it touches,
/// so that none is too short to be seen; the background gets the columns that it has mostly.
fn cell(table: &Table, partition: &Partition, column: u64) -> char {
    let frame = table.frame().0;
    let (from, to) = (frame * column / WIDTH, frame * (column + 1) / WIDTH);
    match table.placements()[partition.id().0].role {
        Role::Windowed { .. } => {
            let own =
                || table.windows_on(partition.cpu()).filter(|w| w.partition == partition.id());
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
                .windows_on(partition.cpu())
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

const HEADER: [&str; 9] = [
    "partition",
    "kind",
    "cpu",
    "memory",
    "runs",
    "own time per frame",
    "share",
    "guard",
    "SCHED_DEADLINE",
];

fn summary(out: &mut String, file: &PartitionFile) {
    let rows: Vec<[String; HEADER.len()]> = std::iter::once(HEADER.map(str::to_owned))
        .chain(file.partitions().iter().map(|p| row(file.table(), p)))
        .collect();
    let widths: [usize; HEADER.len()] =
        std::array::from_fn(|i| rows.iter().map(|row| row[i].len()).max().unwrap_or(0));
    out.push('\n');
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        line(out, &cells.collect::<Vec<_>>().join("  "));
    }
}

fn row(table: &Table, partition: &Partition) -> [String; HEADER.len()] {
    let id = partition.id();
    let own = table.guaranteed(id);
    let share = u128::from(own.0) * 1000 / u128::from(table.frame().0);
    let reservations = CpuReservations::of(table, partition.cpu()).partitions;
    let reservation = reservations.iter().find(|(owner, _)| *owner == id);
    let (runs, guard) = match table.placements()[id.0].role {
        Role::Background => ("background".to_owned(), "-".to_owned()),
        Role::Windowed { guard } => {
            let count = table.windows_on(partition.cpu()).filter(|w| w.partition == id).count();
            (format!("{count} window{}", if count == 1 { "" } else { "s" }), guard.to_string())
        }
    };
    [
        partition.name().to_owned(),
        match partition.kind() {
            Kind::Plc { .. } => "plc".to_owned(),
            Kind::Linux { .. } => "linux".to_owned(),
        },
        partition.cpu().0.to_string(),
        Bytes(partition.memory_bytes()).to_string(),
        runs,
        own.to_string(),
        percent(share as u64),
        guard,
        reservation.map_or("-".to_owned(), |(_, r)| words(*r)),
    ]
}

fn words(reservation: Reservation) -> String {
    format!("{} every {}", reservation.runtime, reservation.period)
}
