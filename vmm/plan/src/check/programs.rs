//! What the programs of a PLC are: where they come from, what they do when, and what they write.

use takt_abi::can::{Controller, Object};
use takt_abi::io::{INPUT, flag, kind};
use takt_abi::live::{PAYLOAD_BYTES, RANGES_EACH_PART, STEP_TICKS};
use takt_abi::program::action;
use takt_program::{Area, Flags, Image, ObjectKind, TaskId, Variable};
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::time::Nanos;

use super::{line, tables, unconnected};
use crate::points;
use crate::program_tasks::{ProgramTask, Release, budgets_of_a_job};
use crate::programs::{action_name, hex};
use crate::{Bus, Bytes, Connection, Partition, PartitionFile, Program, Trust, percent};

/// Most points of a program that are shown.
const POINTS_MAX: usize = 64;

/// Most accesses to the registers of a CAN controller for a frame that is taken, and for one that is handed over.
const RECEIVE_ACCESSES: u32 = 16;
const SEND_ACCESSES: u32 = 15;

/// How the tasks of programs fare under one schedule.
pub fn tasks(out: &mut String, partition: &Partition, schedule: ScheduleId) {
    let met = partition.met_in(schedule);
    if let Some(met) = met {
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
        tables::keep(out, met);
    } else {
        line(out, &format!("\ntasks of {}", partition.name()));
    }
    let response = |task: &ProgramTask| met.zip(task.place).map(|(met, at)| met.responses[at]);
    let rows = partition.program_tasks().iter().map(|task| fate(task, response(task)));
    let header =
        ["task", "released", "priority", "budget", "deadline", "worst response", "verdict"];
    tables::columns(out, "  ", header, rows.collect());
    let endless = endless(partition);
    if !endless.is_empty() {
        let text = format!(
            "  warning: a job that never ends is told of and goes on, with its outputs as they are: {}",
            endless.join(", ")
        );
        line(out, &text);
        line(out, "           give the task a budget, or its program on_deadline = \"stop\"");
    }
    let waiting = behind_holders(partition);
    if !waiting.is_empty() {
        let text = format!(
            "  warning: a less urgent task that holds a semaphore may keep these waiting, and their times do not allow for it: {}",
            waiting.join(", ")
        );
        line(out, &text);
    }
}

/// The tasks of which a job that never ends is told, and of which nothing follows.
fn endless(partition: &Partition) -> Vec<&str> {
    let goes_on = |task: &&ProgramTask| {
        let program = partition.programs().get(task.program);
        program.is_some_and(|program| program.place.on_deadline == action::LOG)
    };
    let unlimited = partition
        .program_tasks()
        .iter()
        .filter(|task| task.budget.is_none() && task.release != Release::Freewheeling);
    unlimited.filter(goes_on).map(|task| &*task.name).collect()
}

/// The tasks with a bound that a less urgent task may keep waiting while it holds a semaphore. A holder runs at its
/// semaphore's ceiling, but no more urgently than the most urgent task of its program (`plc-guest/kernel/src/objects.rs`).
fn behind_holders(partition: &Partition) -> Vec<&str> {
    let tasks = partition.program_tasks();
    let ceiling = |(at, program): (usize, &Program)| {
        let image = program.image()?;
        let semaphores = image.objects().filter_map(|object| match object.kind {
            ObjectKind::Semaphore { ceiling } => Some(ceiling),
            _ => None,
        });
        let own = tasks.iter().filter(|task| task.program == at && task.release.period().is_some());
        let most_urgent = own.map(|task| task.priority).min()?;
        Some(semaphores.min()?.max(most_urgent))
    };
    let ceilings: Vec<_> = partition.programs().iter().enumerate().map(ceiling).collect();
    let waits = |(rank, task): &(usize, &ProgramTask)| {
        let mut less_urgent = tasks.iter().skip(rank + 1);
        // A freewheeling task without a budget is given no semaphore.
        let takes =
            |other: &ProgramTask| other.release != Release::Freewheeling || other.budget.is_some();
        let holds = |other: &ProgramTask| {
            takes(other) && ceilings[other.program].is_some_and(|ceiling| ceiling <= task.priority)
        };
        task.place.is_some() && less_urgent.any(holds)
    };
    tasks.iter().enumerate().filter(waits).map(|(_, task)| task.name.as_str()).collect()
}

fn fate(task: &ProgramTask, response: Option<Nanos>) -> [String; 7] {
    let released = match task.release {
        Release::Cyclic(period, Nanos::ZERO) => format!("each {period}"),
        Release::Cyclic(period, offset) => format!("each {period}, from {offset} on"),
        Release::Event(minimum) => format!("by an event, at most each {minimum}"),
        Release::Freewheeling => "freewheeling".to_owned(),
    };
    let or_none = |time: Option<Nanos>| time.map_or("none".to_owned(), |time| time.to_string());
    let verdict = match (response, task.budget, task.deadline) {
        (Some(response), _, Some(deadline)) => {
            format!("meets, {} of {deadline} to spare", deadline.less(response))
        }
        (_, _, None) => "has no deadline".to_owned(),
        (_, None, _) => "not analysed: it has no budget".to_owned(),
        _ => "not analysed: a more urgent task has no budget".to_owned(),
    };
    [
        task.name.clone(),
        released,
        task.priority.to_string(),
        match (budgets_of_a_job(task.sensitivity), task.budget) {
            (budgets @ 2.., Some(budget)) => format!("{budgets} x {budget}"),
            (_, budget) => or_none(budget),
        },
        or_none(task.deadline),
        response.map_or("-".to_owned(), |response| response.to_string()),
        verdict,
    ]
}

/// The programs of each partition; nothing if there are none.
pub fn list(out: &mut String, file: &PartitionFile) {
    for partition in file.partitions() {
        if partition.programs().is_empty() {
            continue;
        }
        line(out, &format!("\nprograms of {}", partition.name()));
        for (number, program) in partition.programs().iter().enumerate() {
            describe(out, partition, number, program);
        }
        line(out, &watched(partition.programs()));
        partition.can().buses.iter().enumerate().for_each(|(n, bus)| can(out, partition, n, bus));
    }
}

/// A CAN controller, with what a job can spend on it: an access to a register may be an exit of the guest.
fn can(out: &mut String, partition: &Partition, number: usize, bus: &Bus) {
    let all = partition.can().objects.iter().filter(|o| usize::from(o.controller) == number);
    let (received, sent): (Vec<&Object>, Vec<_>) = all.partition(|o| o.direction == INPUT);
    let Controller { kind, place, frames, .. } = bus.controller;
    let kind = if kind == kind::PORT { "I/O port" } else { "memory" };
    line(out, &format!("  CAN {} at {kind} {place:#x}, {}", bus.name, bus.rate()));
    let text = format!(
        "    objects: {} received, {} sent; of each job at most {} register accesses before it and {} behind it",
        received.len(),
        sent.len(),
        if received.is_empty() { 0 } else { RECEIVE_ACCESSES * u32::from(frames) },
        SEND_ACCESSES * u32::from(frames).min(sent.len() as u32),
    );
    line(out, &text);
}

fn describe(out: &mut String, partition: &Partition, number: usize, program: &Program) {
    let Some(image) = program.image() else { return };
    let place = &program.place;
    line(out, &format!("  {}: {} {}", program.name, image.name(), image.version()));
    let text = format!(
        "    image of {}, two banks of {}, a state of {} in {}{}",
        Bytes(place.image_bytes),
        Bytes(place.bank_bytes),
        Bytes(image.state_bytes().into()),
        Bytes(place.state_bytes),
        if place.second_state == 0 { "" } else { ", and a second state for large changes" }
    );
    line(out, &text);
    let trust = match program.trust {
        Trust::Signed(key) => format!("signed with {}", hex(&key)),
        Trust::NotAsked => "signed, but the file has no keys to compare with".to_owned(),
        Trust::Unsigned => "not signed".to_owned(),
    };
    line(out, &format!("    {trust}"));
    let text = format!(
        "    fault -> {}, overrun -> {}, deadline -> {}",
        action_name(place.on_fault),
        action_name(place.on_overrun),
        action_name(place.on_deadline)
    );
    line(out, &text);
    let force = if program.allow_force { "may be written and forced" } else { "read only" };
    line(out, &format!("    from outside: {} in a cycle, {force}", program.watch));
    if let Some(text) = retained(program, &image) {
        line(out, &text);
    }
    points(out, partition, number, &image);
}

/// What a cycle with all that may be watched costs. A step ends when its part is full, or has as many pieces as it may; these
/// count 8 bytes more each, so a step that is not the last is never less than a full part of the budget.
fn watched(programs: &[Program]) -> String {
    const { assert!(9 * RANGES_EACH_PART >= PAYLOAD_BYTES) };
    let bytes = programs.iter().map(|program| program.watch.0).sum::<u64>();
    let steps = bytes.div_ceil(PAYLOAD_BYTES as u64);
    format!(
        "  from outside: {} in a cycle, in at most {steps} steps of {STEP_TICKS} TSC ticks that no task needs",
        Bytes(bytes)
    )
}

/// What outlives a start, and where it is written.
fn retained(program: &Program, image: &Image<'_>) -> Option<String> {
    let values: Vec<Variable<'_>> = image.retained().collect();
    let bytes: u64 = values.iter().map(|v| u64::from(v.bytes)).sum();
    let persistent = values.iter().filter(|v| v.flags.has(Flags::PERSISTENT)).count();
    let place = match &program.retain {
        _ if values.is_empty() => return None,
        Some(file) => format!("written to {} at most each {}", file.path.display(), file.every),
        None => "in no file: they outlive starts of the PLC, not the end of Takt".to_owned(),
    };
    let count = values.len();
    Some(format!(
        "    retained variables: {count} ({persistent} PERSISTENT), {}; {place}",
        Bytes(bytes)
    ))
}

/// Inputs and outputs, the latter with the task that writes them, and what they are connected to.
fn points(out: &mut String, partition: &Partition, number: usize, image: &Image<'_>) {
    let is_point = |v: &Variable<'_>| matches!(v.area, Area::Input | Area::Output);
    let mut points: Vec<Variable<'_>> = image.variables().filter(is_point).collect();
    points.sort_by_key(|v| (v.area, v.offset, v.bit));
    let all = partition.connections();
    let connections: Vec<&Connection> =
        all.iter().filter(|c| usize::from(c.mapping.program) == number).collect();
    let rows = points.iter().take(POINTS_MAX).map(|v| {
        let writer = v.writer.and_then(|id| image.task(id)).map(|task| task.name.to_owned());
        let writer = match v.area {
            Area::Input => "-".to_owned(),
            _ => writer.unwrap_or_else(|| "not told".to_owned()),
        };
        let own = connections.iter().filter(|c| c.meets(v)).map(|c| place(c, image));
        let readers = all.iter().filter(|c| c.reads(number, v)).map(|c| {
            let reader = partition.programs().get(usize::from(c.mapping.program));
            format!("input {} of {}", c.point, reader.map_or("-", |reader| reader.name.as_str()))
        });
        let places = own.chain(readers).collect::<Vec<_>>().join("; ");
        let places = if places.is_empty() { "not connected".to_owned() } else { places };
        [points::address(v), v.name.to_owned(), image.type_name(v.ty).to_string(), writer, places]
    });
    let without_name = connections.iter().filter(|c| !points.iter().any(|v| c.meets(v)));
    let without_name = without_name.map(|c| {
        [c.point.clone(), "-".to_owned(), "-".to_owned(), "-".to_owned(), place(c, image)]
    });
    let rows: Vec<[String; 5]> = rows.chain(without_name).collect();
    if rows.is_empty() {
        return;
    }
    tables::columns(out, "    ", ["point", "name", "type", "writer", "connected to"], rows);
    if points.len() > POINTS_MAX {
        line(out, &format!("    and {} more", points.len() - POINTS_MAX));
    }
    unconnected::warn(out, all, number, &points);
}

/// A place, and what is special about the connection.
fn place(connection: &Connection, image: &Image<'_>) -> String {
    let Connection { mapping, place, .. } = connection;
    let input = mapping.direction == INPUT;
    let reader = image.task(TaskId(mapping.task.into())).filter(|_| input);
    let reader = reader.map(|task| format!(", read by {}", task.name)).unwrap_or_default();
    let special = match (input, mapping.flags & flag::ZERO != 0) {
        (true, true) => ", 0 while invalid",
        (false, false) => ", held at a stop",
        _ => "",
    };
    format!("{place}{reader}{special}")
}
