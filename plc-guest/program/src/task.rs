//! Tasks: what is run, when, and how urgently.

use crate::bytes::Record;
use crate::elementary::Elementary;
use crate::error::{ImageError, Where};
use crate::image::Image;
use crate::layout::task;
use crate::parse::is_code;
use crate::port::Direction;
use crate::section::SectionKind;
use crate::types::TypeKind;
use crate::units::{CodeOffset, Nanoseconds, TaskId};
use crate::{address, limit};

/// A task.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// Its number.
    pub id: TaskId,
    /// Its name.
    pub name: &'a str,
    /// When it is released.
    pub kind: TaskKind<'a>,
    /// How urgent it is: 0 is the most urgent, as in IEC 61131-3.
    pub priority: u8,
    /// The execution time that one job may take; none: it is not bounded.
    pub budget: Option<Nanoseconds>,
    /// How long after its release a job must be done; none for a freewheeling task.
    pub deadline: Option<Nanoseconds>,
    /// Size of its stack in bytes, a multiple of 4096.
    pub stack_bytes: u32,
    /// Its function.
    pub entry: CodeOffset,
    /// How many overruns in a row are tolerated before the watchdog acts; 0: none.
    pub sensitivity: u16,
}

/// When a task is released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskKind<'a> {
    /// At fixed times.
    Cyclic {
        /// The time between two releases.
        period: Nanoseconds,
        /// The first release after the partition's start; less than the period.
        offset: Nanoseconds,
    },
    /// When something happens.
    Event {
        /// What.
        source: EventSource<'a>,
        /// The least time between two releases. Events that come earlier are held until then.
        minimum: Nanoseconds,
    },
    /// Whenever no other task has work.
    Freewheeling,
}

/// What releases an event task. The names of channels, doorbells and interrupts are those of the partition file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventSource<'a> {
    /// A message in the channel of this port of the program.
    Channel(&'a str),
    /// A doorbell.
    Doorbell(&'a str),
    /// A device's interrupt.
    Interrupt(&'a str),
    /// The rising edge of this variable of the program, a `BOOL`.
    Rise(&'a str),
}

/// Numbers of the kinds and of the sources in the file.
pub(crate) mod kind {
    pub const CYCLIC: u8 = 1;
    pub const EVENT: u8 = 2;
    pub const FREEWHEELING: u8 = 3;
    pub const CHANNEL: u32 = 1;
    pub const DOORBELL: u32 = 2;
    pub const INTERRUPT: u32 = 3;
    pub const RISE: u32 = 4;
}

impl<'a> Task<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Tasks, index);
        let time = |field| Nanoseconds(record.u64(field));
        let period = time(task::PERIOD);
        let set = |time: Nanoseconds| (time.0 != 0).then_some(time);
        let source = source(image, record);
        let kind = match record.u8(task::KIND) {
            kind::CYCLIC => TaskKind::Cyclic { period, offset: time(task::OFFSET) },
            kind::EVENT => TaskKind::Event { source, minimum: period },
            _ => TaskKind::Freewheeling,
        };
        Self {
            // At most 16 tasks pass the check.
            id: TaskId(index as u16),
            name: image.strings().get(record.text(task::NAME)),
            kind,
            priority: record.u8(task::PRIORITY),
            budget: set(time(task::BUDGET)),
            deadline: set(time(task::DEADLINE)).or(set(period)),
            stack_bytes: record.u32(task::STACK),
            entry: CodeOffset(record.u32(task::ENTRY)),
            sensitivity: record.u16(task::SENSITIVITY),
        }
    }
}

fn source<'a>(image: &Image<'a>, record: Record<'a>) -> EventSource<'a> {
    let name = image.strings().get(record.text(task::SOURCE));
    match record.u32(task::SOURCE_KIND) {
        kind::CHANNEL => EventSource::Channel(name),
        kind::DOORBELL => EventSource::Doorbell(name),
        kind::INTERRUPT => EventSource::Interrupt(name),
        _ => EventSource::Rise(name),
    }
}

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    for index in image.indices(SectionKind::Tasks) {
        let record = image.record(SectionKind::Tasks, index);
        let whence = Where::new(record.offset, "task", index);
        let name = image.strings().name(whence, record.text(task::NAME))?;
        let same = |task: &Task<'_>| task.name.eq_ignore_ascii_case(name);
        let unique = image.tasks().take(index as usize).all(|task| !same(&task));
        whence.rule(unique, "name", "two tasks have the same name")?;
        check_times(whence, record)?;
        check_source(image, whence, record)?;
        let stack = record.u32(task::STACK);
        whence.at_most("stack", stack.into(), limit::STACK_BYTES.into())?;
        let pages = stack > 0 && u64::from(stack).is_multiple_of(address::PAGE);
        whence.rule(pages, "stack", "the stack is a multiple of 4096 bytes, and not 0")?;
        let entry = record.u32(task::ENTRY);
        whence.rule(is_code(image, entry), "entry", "it must be inside of the code")?;
    }
    Ok(())
}

fn check_times(whence: Where, record: Record<'_>) -> Result<(), ImageError> {
    let time = |field| record.u64(field);
    let (period, offset) = (time(task::PERIOD), time(task::OFFSET));
    let (budget, deadline) = (time(task::BUDGET), time(task::DEADLINE));
    whence.at_most("period", period, limit::PERIOD_NS)?;
    whence.at_most("budget", budget, limit::PERIOD_NS)?;
    match record.u8(task::KIND) {
        kind::CYCLIC => {
            whence.rule(period > 0, "period", "a cyclic task has a period")?;
            whence.rule(offset < period, "offset", "the offset is less than the period")?;
        }
        kind::EVENT => {
            whence.rule(
                period > 0,
                "minimum",
                "an event task has a least time between two events",
            )?;
            whence.zero("offset", offset)?;
        }
        kind::FREEWHEELING => {
            whence.zero("period", period)?;
            whence.zero("offset", offset)?;
            return whence.zero("deadline", deadline);
        }
        other => return Err(whence.value("kind", other.into(), "1 to 3")),
    }
    whence.at_most("deadline", deadline, period)?;
    let deadline = if deadline == 0 { period } else { deadline };
    whence.at_most("budget", budget, deadline)
}

fn check_source(image: &Image<'_>, whence: Where, record: Record<'_>) -> Result<(), ImageError> {
    let (code, text) = (record.u32(task::SOURCE_KIND), record.text(task::SOURCE));
    if record.u8(task::KIND) != kind::EVENT {
        whence.zero("source kind", code.into())?;
        return whence.rule(text == (0, 0), "source", "only an event task has a source");
    }
    let name = image.strings().name(whence, text)?;
    match code {
        kind::CHANNEL => {
            let port = image.ports().find(|port| port.name == name);
            whence.rule(port.is_some(), "source", "the program has no port of this name")?;
            let reads = port.is_some_and(|port| port.direction == Direction::In);
            whence.rule(reads, "source", "no message comes to a port that the program writes")
        }
        kind::DOORBELL | kind::INTERRUPT => Ok(()),
        kind::RISE => {
            let ty = image.variable(name).and_then(|variable| image.type_of(variable.ty));
            let is_bool = ty.is_some_and(|ty| ty.kind == TypeKind::Elementary(Elementary::Bool));
            whence.rule(is_bool, "source", "the program has no BOOL of this name")
        }
        other => Err(whence.value("source kind", other.into(), "1 to 4")),
    }
}
