//! What the schedules amount to, in columns.

use takt_scheduler::analysis::Method;
use takt_scheduler::reservation::{CEILING_PERMILLE, CpuReservations, Reservation};
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::{Cpu, PartitionId, Role, Table};
use takt_scheduler::time::Nanos;

use super::{line, programs};
use crate::{
    Bytes, INTERRUPT, Kind, Met, NamedTask, Partition, PartitionFile, WAKE_UP_ALLOWANCE, percent,
};

/// What each partition has under one schedule, whatever the others do.
pub fn shares(out: &mut String, file: &PartitionFile, table: &Table) {
    let row = |partition: &Partition, cpu: Cpu| {
        let id = partition.id();
        let role = table.placements()[id.0].role;
        let own = match role {
            Role::Background => file.own_time_on(table, id, cpu),
            Role::Windowed { .. } => file.own_time(table, id),
        };
        let runs = match (role, table.windows_of(id).count()) {
            (Role::Background, _) => match table.backgrounds_of(cpu).count() {
                1 => "background".to_owned(),
                several => format!("background of {several}"),
            },
            (Role::Windowed { .. }, 0) => "not at all".to_owned(),
            (Role::Windowed { .. }, 1) => "1 window".to_owned(),
            (Role::Windowed { .. }, count) => format!("{count} windows"),
        };
        let share = percent(permille(own, table.frame()));
        let name = match partition.cpus().count() {
            1 => partition.name().to_owned(),
            _ => format!("{} on CPU {}", partition.name(), cpu.0),
        };
        [name, runs, own.to_string(), share]
    };
    let rows =
        file.partitions().iter().flat_map(|p| p.cpus().map(move |cpu| row(p, cpu))).collect();
    columns(out, "", ["partition", "runs", "own time per frame", "share"], rows);
}

/// How the tasks of each partition fare under one schedule.
pub fn tasks(out: &mut String, file: &PartitionFile, schedule: ScheduleId) {
    for partition in file.partitions() {
        if !partition.programs().is_empty() {
            programs::tasks(out, partition, schedule);
            continue;
        }
        let Some(met) = partition.met_in(schedule) else { continue };
        let load = met.load;
        let text = format!(
            "\ntasks of {}: they may ask for {} of the {} that its windows give in {}: {}",
            partition.name(),
            load.demand,
            load.supply,
            load.span,
            percent(load.permille())
        );
        line(out, &text);
        keep(out, met);
        let rows = partition.tasks().iter().zip(&met.responses);
        let rows = rows.map(|(task, response)| fate(met, task, *response)).collect();
        let header = ["task", "period", "budget", "priority", "worst response", "verdict"];
        columns(out, "  ", header, rows);
    }
}

/// Says what the analysis takes from each window, and for what.
pub fn keep(out: &mut String, met: &Met) {
    for (time, what) in kept(met) {
        line(out, &format!("  {time} of each window are kept for {what}"));
    }
}

fn kept(met: &Met) -> impl Iterator<Item = (Nanos, String)> {
    let interrupts = met.interrupts.terms().map(|(count, what)| {
        (Nanos(count * INTERRUPT.0), format!("{what} ({count} x {INTERRUPT})"))
    });
    let wake_up = match met.wake_up > WAKE_UP_ALLOWANCE {
        true => "the kick of the partition before, and the way into the guest",
        false => "a wake-up that the guard has no room for",
    };
    interrupts
        .into_iter()
        .chain([(met.wake_up, wake_up.to_owned())])
        .filter(|(time, _)| *time > Nanos::ZERO)
}

fn fate(met: &Met, NamedTask { name, task }: &NamedTask, response: Nanos) -> [String; 6] {
    let verdict = format!(
        "meets, {} of {} to spare ({})",
        task.period.less(response),
        task.period,
        match met.method {
            Method::Exact => "exact",
            Method::Bound => "bound",
        }
    );
    [
        name.clone(),
        task.period.to_string(),
        task.budget.to_string(),
        task.priority.to_string(),
        response.to_string(),
        verdict,
    ]
}

/// What is the same under every schedule, and the least time that each partition has in any.
pub fn partitions(out: &mut String, file: &PartitionFile) {
    let schedules = file.schedules();
    let row = |partition: &Partition| {
        let id = partition.id();
        let least = file.least_own_time(id);
        let guard = match schedules.placements()[id.0].role {
            Role::Background => "-".to_owned(),
            Role::Windowed { guard } if partition.has_auto_guard() => format!("auto, {guard}"),
            Role::Windowed { guard } => guard.to_string(),
        };
        let (kind, change) = match partition.kind() {
            Kind::Plc { .. } => ("plc", partition.on_schedule_change().to_string()),
            Kind::Linux { .. } => ("linux", "-".to_owned()),
        };
        let reservations = CpuReservations::of(schedules, partition.cpu()).partitions;
        let reservation = reservations.iter().find(|(owner, _)| *owner == id);
        [
            partition.name().to_owned(),
            kind.to_owned(),
            partition.cpus().map(|cpu| cpu.0.to_string()).collect::<Vec<_>>().join(", "),
            Bytes(partition.memory_bytes()).to_string(),
            guard,
            change,
            format!("{least}, {}", percent(permille(least, schedules.frame()))),
            reservation.map_or("-".to_owned(), |(_, r)| words(*r)),
        ]
    };
    let header = [
        "partition",
        "kind",
        "cpu",
        "memory",
        "guard",
        "switch",
        "least own time",
        "SCHED_DEADLINE",
    ];
    columns(out, "", header, file.partitions().iter().map(row).collect());
}

/// What the kernel's deadline scheduler is asked for, per CPU. The threads keep their reservations
/// under all schedules.
pub fn reservations(out: &mut String, file: &PartitionFile) {
    out.push('\n');
    for cpu in file.schedules().cpus() {
        let reservations = CpuReservations::of(file.schedules(), cpu);
        let Some(kicker) = reservations.kicker else { continue };
        let text = format!(
            "CPU {}: {} reserved, of at most {}; {} to end windows",
            cpu.0,
            percent(reservations.permille()),
            percent(CEILING_PERMILLE),
            words(kicker)
        );
        line(out, &text);
        if !reservations.has_room_for_looks() {
            line(
                out,
                "       no room to look at the clock: if it becomes slower by a tenth, a partition that",
            );
            line(out, "       does not say done may have its own next release late");
        }
    }
}

/// Which background partitions share what the windows of a CPU leave.
pub fn sharing(out: &mut String, file: &PartitionFile) {
    let table = &file.schedules().tables()[0];
    for cpu in table.cpus() {
        let own = |id: PartitionId| &file.partitions()[id.0];
        let all: Vec<&Partition> = table.backgrounds_of(cpu).map(own).collect();
        if all.len() > 1 {
            let threads: u64 = all.iter().map(|p| p.background_threads(cpu)).sum();
            let names: Vec<&str> = all.iter().map(|p| p.name()).collect();
            let text = format!(
                "CPU {}: {} share what windows leave; each of their {threads} threads weighs the same",
                cpu.0,
                names.join(", ")
            );
            line(out, &text);
        }
    }
}

/// The partitions whose deadlines were not analysed.
pub fn not_analysed(out: &mut String, file: &PartitionFile) {
    for partition in file.partitions() {
        let has_tasks = !partition.tasks().is_empty() || !partition.programs().is_empty();
        if matches!(partition.kind(), Kind::Plc { .. }) && !has_tasks {
            line(out, &format!("{}: no tasks given: not analysed", partition.name()));
        }
    }
}

/// Rows of cells below a header, each column as wide as it must be.
pub fn columns<const N: usize>(
    out: &mut String,
    indent: &str,
    header: [&str; N],
    mut rows: Vec<[String; N]>,
) {
    rows.insert(0, header.map(str::to_owned));
    let widths: [usize; N] =
        std::array::from_fn(|i| rows.iter().map(|row| row[i].len()).max().unwrap_or(0));
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        line(out, &format!("{indent}{}", cells.collect::<Vec<_>>().join("  ")));
    }
}

fn words(reservation: Reservation) -> String {
    format!("{} every {}", reservation.runtime, reservation.period)
}

/// A part of the frame in parts of a thousand, rounded down.
fn permille(part: Nanos, frame: Nanos) -> u64 {
    (u128::from(part.0) * 1000 / u128::from(frame.0)) as u64
}
