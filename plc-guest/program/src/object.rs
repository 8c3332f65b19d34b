//! Kernel objects: how the tasks of a program talk and wait. They are made at the start, never later.

use crate::error::{ImageError, Where};
use crate::image::Image;
use crate::layout::object;
use crate::limit;
use crate::section::SectionKind;

/// A kernel object. Its number in calls is its place in the table.
#[derive(Clone, Copy, Debug)]
pub struct Object<'a> {
    /// Its name.
    pub name: &'a str,
    /// What it is.
    pub kind: ObjectKind,
}

/// What a kernel object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKind {
    /// Lets one task at a time into a critical section.
    Semaphore {
        /// The priority of the most urgent task that takes it. Its holder runs at this priority.
        ceiling: u8,
    },
    /// Holds messages in their order.
    Queue {
        /// Size of the longest message, in bytes.
        message_bytes: u32,
        /// Most messages.
        depth: u32,
    },
    /// Holds the last value written.
    Mailbox {
        /// Size of the longest value, in bytes.
        bytes: u32,
    },
    /// 32 bits to wait for.
    Flags,
}

/// Numbers of the kinds in the file.
pub(crate) mod kind {
    pub const SEMAPHORE: u8 = 1;
    pub const QUEUE: u8 = 2;
    pub const MAILBOX: u8 = 3;
    pub const FLAGS: u8 = 4;
}

impl<'a> Object<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Objects, index);
        let (a, b) = (record.u32(object::A), record.u32(object::B));
        let kind = match record.u8(object::KIND) {
            // At most 255 passes the check.
            kind::SEMAPHORE => ObjectKind::Semaphore { ceiling: a as u8 },
            kind::QUEUE => ObjectKind::Queue { message_bytes: a, depth: b },
            kind::MAILBOX => ObjectKind::Mailbox { bytes: a },
            _ => ObjectKind::Flags,
        };
        Self { name: image.strings().get(record.text(object::NAME)), kind }
    }
}

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    for index in image.indices(SectionKind::Objects) {
        let record = image.record(SectionKind::Objects, index);
        let whence = Where::new(record.offset, "object", index);
        let name = image.strings().name(whence, record.text(object::NAME))?;
        let same = |object: &Object<'_>| object.name.eq_ignore_ascii_case(name);
        let unique = image.objects().take(index as usize).all(|object| !same(&object));
        whence.rule(unique, "name", "two objects have the same name")?;
        for at in 1..4 {
            whence.zero("reserved", record.u8(object::KIND + at).into())?;
        }
        whence.zero("reserved", record.u32(object::RESERVED).into())?;
        let (a, b) = (u64::from(record.u32(object::A)), u64::from(record.u32(object::B)));
        let message = |field| {
            whence.rule(a > 0, field, "it has at least one byte")?;
            whence.at_most(field, a, limit::MESSAGE_BYTES.into())
        };
        match record.u8(object::KIND) {
            kind::SEMAPHORE => {
                whence.at_most("ceiling", a, u8::MAX.into())?;
                whence.zero("b", b)?;
            }
            kind::QUEUE => {
                message("message bytes")?;
                whence.rule(b > 0, "depth", "it has room for at least one message")?;
                whence.at_most("depth", b, limit::QUEUE_DEPTH.into())?;
            }
            kind::MAILBOX => {
                message("bytes")?;
                whence.zero("b", b)?;
            }
            kind::FLAGS => {
                whence.zero("a", a)?;
                whence.zero("b", b)?;
            }
            other => return Err(whence.value("kind", other.into(), "1 to 4")),
        }
    }
    Ok(())
}
