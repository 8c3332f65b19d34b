//! What the inputs of programs are read from, and where their outputs are written to.
//!
//! A program knows its process image only. What a point of it is connected to is the plant's business, and stands in
//! the partition file: so a program that is tested with simulated inputs is the one that runs with real ones. All that
//! could be connected wrongly is found here, where the line can be shown: the guest finds numbers ([`takt_abi::io`]).
//!
//! - [`point`]: which bytes of which image a table names;
//! - [`place`]: channels and registers;
//! - [`controllers`], [`can`]: CAN controllers, and objects on their buses;
//! - [`of_program`]: outputs of programs;
//! - [`simulate`]: simulated values;
//! - [`types`]: which types can be connected;
//! - [`ends`]: the two ends of a channel;
//! - [`writers`]: what two tables must not share.

mod can;
mod controllers;
mod ends;
mod of_program;
mod place;
mod point;
mod simulate;
mod types;
mod writers;

use takt_abi::can::Object;
use takt_abi::io::{ANY_TASK, INPUT, IoTable, MAPPINGS_MAX, Mapping, OUTPUT, WHOLE, flag, kind};
use takt_program::{Area, Elementary, Image, TaskId, Variable};
use toml::Spanned;

use super::channels::Channel;
use super::diagnostic::{Diagnostic, Span, quote};
use super::partition::Checked;
use super::passthrough::Passthrough;
use super::programs::CheckedProgram;
use super::raw::{self, Keys};
pub use controllers::Bus;
use point::{Direction, Point};

/// A point that is connected.
#[derive(Clone, Debug)]
pub struct Connection {
    /// What the guest is told.
    pub mapping: Mapping,
    /// The point as the file names it.
    pub point: String,
    /// The place in words.
    pub place: String,
}

impl Connection {
    /// True if some bits of a variable of its program are connected by it.
    #[must_use]
    pub fn meets(&self, variable: &Variable<'_>) -> bool {
        let area = if self.mapping.direction == INPUT { Area::Input } else { Area::Output };
        variable.area == area && writers::meet(writers::in_image(&self.mapping), bits_of(variable))
    }

    /// True if it is an input that comes from some bits of this output of the program with this place.
    #[must_use]
    pub fn reads(&self, program: usize, output: &Variable<'_>) -> bool {
        let m = &self.mapping;
        let from = (m.kind, m.place) == (kind::PROGRAM, program as u64);
        let bits = writers::meet(writers::at_place(m), bits_of(output));
        from && output.area == Area::Output && bits
    }
}

/// The bits of a variable in its area.
fn bits_of(variable: &Variable<'_>) -> writers::Bits {
    let bit = variable.bit.unwrap_or(WHOLE);
    writers::bits(variable.offset.into(), bit, variable.bytes.into())
}

/// What the kernel of a partition drives for its programs.
#[derive(Clone, Debug, Default)]
pub struct Can {
    /// The controllers, in the order of the file.
    pub buses: Vec<Bus>,
    /// The objects, in the order in which the file names them first.
    pub objects: Vec<Object>,
}

/// What the tables of one partition are checked against.
#[derive(Clone, Copy)]
struct Around<'a> {
    partition: &'a Checked,
    channels: &'a [Channel],
    passthrough: &'a Passthrough,
    buses: &'a [Bus],
}

/// A place, in the terms of the guest and in words.
struct Place {
    mapping: Mapping,
    words: String,
}

/// A table that obeys its own rules, with the places that later rules point at.
struct Entry<'a> {
    connection: Connection,
    point: Point,
    /// The value that names the point.
    named: Span,
    /// The value that names the place.
    placed: Span,
    raw: &'a raw::Io,
}

/// Checks the tables of all partitions, in the order of the file.
pub fn check(
    raw: &[Spanned<Keys<raw::Partition>>],
    partitions: &[Checked],
    channels: &[Channel],
    passthrough: &[Passthrough],
) -> Result<Vec<(Vec<Connection>, Can)>, Diagnostic> {
    let (mut entries, mut cans) = (Vec::with_capacity(raw.len()), Vec::with_capacity(raw.len()));
    for ((partition, passthrough), table) in partitions.iter().zip(passthrough).zip(raw) {
        let Keys(raw) = table.get_ref();
        let around = Around { partition, channels, passthrough, buses: &[] };
        let buses = controllers::check(&raw.can.0, around)?;
        let mut own = check_partition(&raw.io.0, Around { buses: &buses, ..around })?;
        controllers::check_registers(&own, &buses)?;
        cans.push(Can { objects: can::objects(&mut own)?, buses });
        entries.push(own);
    }
    ends::check(&entries, partitions, channels)?;
    let sorted = entries.into_iter().zip(cans).map(|(entries, can)| {
        let mut connections: Vec<Connection> = entries.into_iter().map(|e| e.connection).collect();
        connections.sort_by_key(|connection| order(&connection.mapping));
        (connections, can)
    });
    Ok(sorted.collect())
}

fn check_partition<'a>(
    tables: &'a [Spanned<Keys<raw::Io>>],
    around: Around<'_>,
) -> Result<Vec<Entry<'a>>, Diagnostic> {
    if let Some(excess) = tables.get(MAPPINGS_MAX) {
        let found = format!("this is table {} of {}", MAPPINGS_MAX + 1, tables.len());
        let allowed = format!(
            "at most {MAPPINGS_MAX} tables [[partition.io]] in a partition; one can be for an array or a structure"
        );
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut entries: Vec<Entry<'_>> = Vec::with_capacity(tables.len());
    for table in tables {
        let next = check_one(table, around)?;
        writers::check(&next, &entries)?;
        entries.push(next);
    }
    writers::check_ports(&entries, around)?;
    Ok(entries)
}

/// In this order the guest finds them: by program, inputs first, and places together.
fn order(m: &Mapping) -> (u8, u8, u8, u64, u8, u32, u8, u32) {
    let class = match m.kind {
        _ if is_channel(m) => kind::FIELD,
        _ if can::is_can(m) => kind::CAN,
        kind => kind,
    };
    (m.program, m.direction, class, m.place, m.width, m.field, m.place_bit, m.offset)
}

const fn is_channel(m: &Mapping) -> bool {
    matches!(m.kind, kind::FIELD | kind::VALID | kind::AGE)
}

fn check_one<'a>(
    table: &'a Spanned<Keys<raw::Io>>,
    around: Around<'_>,
) -> Result<Entry<'a>, Diagnostic> {
    let Keys(raw) = table.get_ref();
    let header = table.span();
    let (number, program) = find_program(raw.program.as_ref(), "program", &header, around)?;
    let Some(image) = program.program.image() else {
        return Err(Diagnostic::new(header, "its program has no image", "a program with an image"));
    };
    let (point, named) = point::find(raw, &header, &image)?;
    let direction = match point.direction {
        Direction::Input => INPUT,
        Direction::Output => OUTPUT,
    };
    let mapping = Mapping {
        program: number,
        direction,
        task: check_task(raw, &point, &image, &named)?,
        bit: point.bit.unwrap_or(WHOLE),
        place_bit: WHOLE,
        offset: point.offset,
        bytes: point.bytes,
        ty: point.ty.map_or(0, |ty| ty.code().into()),
        ..Mapping::NONE
    };
    let (Place { mut mapping, words }, placed) =
        place::find(raw, &header, &point, mapping, around)?;
    mapping.flags = check_flags(raw, &mapping)?;
    let connection = Connection { mapping, point: point.name.clone(), place: words };
    Ok(Entry { connection, point, named, placed, raw })
}

/// A program of the partition by its name, which may be left out if it is the only one.
fn find_program<'a>(
    name: Option<&Spanned<String>>,
    key: &str,
    header: &Span,
    around: Around<'a>,
) -> Result<(u8, &'a CheckedProgram), Diagnostic> {
    let programs = &around.partition.programs;
    let names = || {
        let names: Vec<String> = programs.iter().map(|p| quote(&p.program.name)).collect();
        if names.is_empty() { "a [[partition.program]]".to_owned() } else { names.join(", ") }
    };
    let at = match name {
        Some(name) => {
            let at = programs.iter().position(|p| p.program.name == *name.get_ref());
            at.ok_or_else(|| {
                let found = format!("the partition has no program {}", quote(name.get_ref()));
                Diagnostic::new(name.span(), found, names())
            })?
        }
        None if programs.len() == 1 => 0,
        None => {
            let found = match programs.len() {
                0 => "the partition has no programs".to_owned(),
                count => format!("which of the {count} programs is meant is not said"),
            };
            let allowed = match programs.len() {
                0 => names(),
                _ => format!("`{key}` with one of {}", names()),
            };
            return Err(Diagnostic::new(header.clone(), found, allowed));
        }
    };
    // There are at most 16.
    Ok((at as u8, &programs[at]))
}

/// Which task's jobs read an input, or write an output.
fn check_task(
    raw: &raw::Io,
    point: &Point,
    image: &Image<'_>,
    named: &Span,
) -> Result<u8, Diagnostic> {
    match (point.direction, &raw.task) {
        (Direction::Input, None) => Ok(ANY_TASK),
        (Direction::Input, Some(name)) => {
            let task = image.tasks().find(|task| task.name.eq_ignore_ascii_case(name.get_ref()));
            task.map(|task| task.id.0 as u8).ok_or_else(|| {
                let found = format!("the program has no task {}", quote(name.get_ref()));
                let names: Vec<String> = image.tasks().map(|task| quote(task.name)).collect();
                Diagnostic::new(name.span(), found, names.join(", "))
            })
        }
        (Direction::Output, Some(name)) => {
            let found = "`task` says which task reads an input, and this is an output";
            let allowed = "no `task`: the image says which task writes an output";
            Err(Diagnostic::new(name.span(), found, allowed))
        }
        (Direction::Output, None) => match point.writer {
            _ if image.tasks().len() == 1 => Ok(0),
            Some(TaskId(task)) => Ok(task as u8),
            None => {
                let found = format!("no task is known that alone writes {}", quote(&point.name));
                let allowed = "an output of one task; in a program with several tasks its image names it \
                               (in Structured Text: the outputs of different tasks in different bytes)";
                Err(Diagnostic::new(named.clone(), found, allowed))
            }
        },
    }
}

/// What becomes of the point when there is no value for it.
fn check_flags(raw: &raw::Io, mapping: &Mapping) -> Result<u8, Diagnostic> {
    let zero = |value: &Spanned<String>, key: &str| match value.get_ref().as_str() {
        "hold" => Ok(0),
        "zero" => Ok(flag::ZERO),
        other => {
            let found = format!("there is no value {} for `{key}`", quote(other));
            Err(Diagnostic::new(value.span(), found, "\"hold\" or \"zero\""))
        }
    };
    if let Some(key) = raw.on_stop.as_ref().filter(|_| mapping.direction == INPUT) {
        let found =
            "`on_stop` is about outputs of a program that has stopped, and this is an input";
        return Err(Diagnostic::new(key.span(), found, "`on_stop` for an output"));
    }
    let of_field = mapping.direction == INPUT && mapping.kind == kind::FIELD;
    if let Some(key) = raw.on_invalid.as_ref().filter(|_| !of_field) {
        let found = "`on_invalid` is about a field of a channel's message";
        let allowed = "`on_invalid` for an input with `channel` and `byte`";
        return Err(Diagnostic::new(key.span(), found, allowed));
    }
    match (mapping.direction, &raw.on_stop, &raw.on_invalid) {
        (OUTPUT, Some(value), _) => zero(value, "on_stop"),
        (OUTPUT, None, _) => Ok(flag::ZERO),
        (_, _, Some(value)) => zero(value, "on_invalid"),
        _ => Ok(0),
    }
}

/// A BOOL takes one bit.
fn is_bool(point: &Point) -> bool {
    point.ty == Some(Elementary::Bool)
}

/// The table that the guest finds, with the interrupts that release tasks.
pub fn table(connections: &[Connection], can: &Can, events: &[Mapping]) -> IoTable {
    let mut all: Vec<Mapping> = connections.iter().map(|c| c.mapping).collect();
    all.extend(events);
    all.sort_by_key(order);
    let mut table = IoTable { count: all.len() as u32, ..IoTable::EMPTY };
    table.mappings.iter_mut().zip(all).for_each(|(entry, mapping)| *entry = mapping);
    let controllers = can.buses.iter().map(|bus| bus.controller);
    table.controllers.iter_mut().zip(controllers).for_each(|(entry, c)| *entry = c);
    table.objects.iter_mut().zip(&can.objects).for_each(|(entry, object)| *entry = *object);
    table
}
