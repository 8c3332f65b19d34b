//! What Takt orders.

use super::bytes::{Reader, Writer};
use super::place::{Point, Range};

const STATUS: u16 = 1;
const WATCH_CLEAR: u16 = 2;
const WATCH_ADD: u16 = 3;
const WATCH_BEGIN: u16 = 4;
const WRITE: u16 = 5;
const FORCE: u16 = 6;
const RELEASE: u16 = 7;
const RELEASE_ALL: u16 = 8;
const PREPARE: u16 = 16;
const CHANGE: u16 = 17;

/// Most ranges of one order.
pub const RANGES_EACH: usize = 120;
const _: () = assert!(8 + 1 + RANGES_EACH * Range::BYTES <= super::MESSAGE_BYTES);

/// An order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(clippy::large_enum_variant, reason = "a kernel has no heap for the large one")]
pub enum Order {
    /// Tell how the programs stand (part 0), or the tasks from `(part - 1) * TASKS_EACH` on.
    Status {
        /// Which part.
        part: u16,
    },
    /// Begin a list of ranges to be watched. What is watched goes on until the list is complete.
    WatchClear,
    /// More of that list.
    WatchAdd(Ranges),
    /// Watch the list from now on: send its bytes at the end of a window's work, as samples with this number.
    WatchBegin {
        /// For the samples. 0 ends all of it.
        serial: u32,
        /// Least time from one sample to the next, in nanoseconds; 0 is each window.
        interval_ns: u64,
    },
    /// Write a value once, between two jobs. Of a bit, bit 0 of the value.
    Write {
        /// Where.
        point: Point,
        /// Little-endian; the first bytes count.
        value: u64,
    },
    /// Keep a value from now on.
    Force {
        /// Where. A second force of the same point replaces the first.
        point: Point,
        /// As in [`Write`](Self::Write).
        value: u64,
    },
    /// Keep the value no longer.
    Release {
        /// Of this point.
        point: Point,
    },
    /// Keep no value any longer.
    ReleaseAll,
    /// Another version of a program lies in its free bank, with its change plans: get ready to change to it.
    Prepare {
        /// Place of the program in the program table.
        program: u8,
        /// Length of the image, which begins with the bank.
        image_bytes: u32,
        /// Length of the plan to the new version, which begins at the page behind the image.
        forward_bytes: u32,
        /// Length of the plan back, which begins at the next multiple of 8 behind that.
        back_bytes: u32,
    },
    /// Go on with the change of this program.
    Change {
        /// Place of the program in the program table.
        program: u8,
        /// How.
        step: ChangeStep,
    },
}

/// Some ranges of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ranges {
    all: [Option<Range>; RANGES_EACH],
    count: u8,
}

impl Ranges {
    /// As many of these as have room.
    #[must_use]
    pub fn new(ranges: &[Range]) -> Self {
        let mut all = [None; RANGES_EACH];
        let count = ranges.len().min(RANGES_EACH);
        all.iter_mut().zip(ranges).for_each(|(slot, range)| *slot = Some(*range));
        Self { all, count: count as u8 }
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = Range> {
        self.all.iter().copied().map_while(|range| range)
    }

    fn write(&self, to: &mut Writer<'_>) {
        to.u8(self.count);
        self.iter().for_each(|range| range.write(to));
    }

    fn read(from: &mut Reader<'_>) -> Option<Self> {
        let count = from.u8()?;
        let mut all = [None; RANGES_EACH];
        for slot in all.get_mut(..usize::from(count))? {
            *slot = Some(Range::read(from)?);
        }
        Some(Self { all, count })
    }
}

/// How a change goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ChangeStep {
    /// Only tell how it stands.
    Tell = 0,
    /// Change to the version that is prepared, as soon as no task of the program has a job.
    Commit = 1,
    /// Change back; a version that is only prepared is given up.
    RollBack = 2,
}

impl ChangeStep {
    const ALL: [Self; 3] = [Self::Tell, Self::Commit, Self::RollBack];
}

impl Order {
    /// Writes it, with its number; `None` if it has no room.
    #[must_use]
    pub fn encode<'b>(&self, number: u32, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
        let mut to = Writer::new(buffer);
        let kind = match self {
            Order::Status { .. } => STATUS,
            Order::WatchClear => WATCH_CLEAR,
            Order::WatchAdd(_) => WATCH_ADD,
            Order::WatchBegin { .. } => WATCH_BEGIN,
            Order::Write { .. } => WRITE,
            Order::Force { .. } => FORCE,
            Order::Release { .. } => RELEASE,
            Order::ReleaseAll => RELEASE_ALL,
            Order::Prepare { .. } => PREPARE,
            Order::Change { .. } => CHANGE,
        };
        to.u16(kind);
        to.u16(0);
        to.u32(number);
        match *self {
            Order::Status { part } => to.u16(part),
            Order::WatchClear | Order::ReleaseAll => {}
            Order::WatchAdd(ranges) => ranges.write(&mut to),
            Order::WatchBegin { serial, interval_ns } => {
                to.u32(serial);
                to.u64(interval_ns);
            }
            Order::Write { point, value } | Order::Force { point, value } => {
                point.write(&mut to);
                to.u64(value);
            }
            Order::Release { point } => point.write(&mut to),
            Order::Prepare { program, image_bytes, forward_bytes, back_bytes } => {
                to.u8(program);
                [image_bytes, forward_bytes, back_bytes].into_iter().for_each(|n| to.u32(n));
            }
            Order::Change { program, step } => {
                to.u8(program);
                to.u8(step as u8);
            }
        }
        to.end()
    }
}

/// Reads an order and its number. An order that is none has a number if it is long enough for one.
///
/// # Errors
/// The number of a message that is no order, if it has one.
pub fn decode_order(message: &[u8]) -> Result<(u32, Order), Option<u32>> {
    let mut from = Reader(message);
    let head = (from.u16(), from.u16(), from.u32());
    let (Some(kind), Some(zero), Some(number)) = head else { return Err(None) };
    let order = if zero == 0 { body(kind, &mut from) } else { None };
    order.map(|order| (number, order)).ok_or(Some(number))
}

fn body(kind: u16, from: &mut Reader<'_>) -> Option<Order> {
    let order = match kind {
        STATUS => Order::Status { part: from.u16()? },
        WATCH_CLEAR => Order::WatchClear,
        WATCH_ADD => Order::WatchAdd(Ranges::read(from)?),
        WATCH_BEGIN => Order::WatchBegin { serial: from.u32()?, interval_ns: from.u64()? },
        WRITE => Order::Write { point: Point::read(from)?, value: from.u64()? },
        FORCE => Order::Force { point: Point::read(from)?, value: from.u64()? },
        RELEASE => Order::Release { point: Point::read(from)? },
        RELEASE_ALL => Order::ReleaseAll,
        PREPARE => Order::Prepare {
            program: from.u8()?,
            image_bytes: from.u32()?,
            forward_bytes: from.u32()?,
            back_bytes: from.u32()?,
        },
        CHANGE => {
            let (program, code) = (from.u8()?, from.u8()?);
            let step = ChangeStep::ALL.into_iter().find(|step| *step as u8 == code)?;
            Order::Change { program, step }
        }
        _ => return None,
    };
    from.end(order)
}

#[cfg(test)]
#[path = "order_tests.rs"]
mod tests;
