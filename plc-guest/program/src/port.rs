//! Channel ports: through which a program talks to other partitions.

use crate::code::codes;
use crate::error::{ImageError, Where};
use crate::image::Image;
use crate::layout::port;
use crate::limit;
use crate::section::SectionKind;

codes! {
    /// Which way messages go.
    pub enum Direction: u8 {
        /// The program reads them.
        In = 1,
        /// The program writes them.
        Out = 2,
    }
}

/// A channel port. Its number in calls is its place in the table; the partition file connects it by its name.
#[derive(Clone, Copy, Debug)]
pub struct Port<'a> {
    /// Its name.
    pub name: &'a str,
    /// Which way messages go.
    pub direction: Direction,
    /// Size of the longest message, in bytes.
    pub message_bytes: u32,
}

impl<'a> Port<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Ports, index);
        let direction = Direction::from_code(record.u8(port::DIRECTION));
        Self {
            name: image.strings().get(record.text(port::NAME)),
            // Only a port that `check` has let pass is read again.
            direction: direction.unwrap_or(Direction::In),
            message_bytes: record.u32(port::SIZE),
        }
    }
}

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    for index in image.indices(SectionKind::Ports) {
        let record = image.record(SectionKind::Ports, index);
        let whence = Where::new(record.offset, "port", index);
        let name = image.strings().name(whence, record.text(port::NAME))?;
        let same = |port: &Port<'_>| port.name.eq_ignore_ascii_case(name);
        let unique = image.ports().take(index as usize).all(|port| !same(&port));
        whence.rule(unique, "name", "two ports have the same name")?;
        let direction = record.u8(port::DIRECTION);
        if Direction::from_code(direction).is_none() {
            return Err(whence.value("direction", direction.into(), "1 and 2"));
        }
        for at in 1..4 {
            whence.zero("reserved", record.u8(port::DIRECTION + at).into())?;
        }
        let bytes = record.u32(port::SIZE);
        whence.rule(bytes > 0, "message bytes", "a message has at least one byte")?;
        whence.at_most("message bytes", bytes.into(), limit::MESSAGE_BYTES.into())?;
    }
    Ok(())
}
