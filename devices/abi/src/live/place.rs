//! Where values lie: in an area of a program.

use super::bytes::{Reader, Writer};

/// No bit: all of the bytes.
const NO_BIT: u8 = 255;

/// An area of a program that can be looked at. The numbers are those of the program image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Area {
    /// Its state.
    State = 1,
    /// Its inputs `%I`.
    Input = 2,
    /// Its outputs `%Q`.
    Output = 3,
    /// Its markers `%M`.
    Marker = 4,
}

impl Area {
    /// The area of this number.
    #[must_use]
    pub fn of(number: u8) -> Option<Self> {
        let all = [Self::State, Self::Input, Self::Output, Self::Marker];
        all.into_iter().find(|area| *area as u8 == number)
    }
}

/// Some bytes of a program. Ranges are ordered by where they lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Range {
    /// Place of the program in the program table.
    pub program: u8,
    /// The area.
    pub area: Area,
    /// Offset in the area.
    pub offset: u32,
    /// How many bytes.
    pub bytes: u16,
}

/// A place of one value of at most 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Point {
    /// Its bytes, 1 to 8.
    pub range: Range,
    /// One bit of a single byte, 0 to 7.
    pub bit: Option<u8>,
}

impl Range {
    /// What it takes in a message.
    pub(super) const BYTES: usize = 8;

    pub(super) fn write(self, to: &mut Writer<'_>) {
        to.u8(self.program);
        to.u8(self.area as u8);
        to.u16(self.bytes);
        to.u32(self.offset);
    }

    pub(super) fn read(from: &mut Reader<'_>) -> Option<Self> {
        let (program, area, bytes) = (from.u8()?, Area::of(from.u8()?)?, from.u16()?);
        let range = Self { program, area, offset: from.u32()?, bytes };
        (bytes > 0).then_some(range)
    }
}

impl Point {
    /// A point, if it can be one.
    #[must_use]
    pub fn new(range: Range, bit: Option<u8>) -> Option<Self> {
        let fits = match bit {
            None => (1..=8).contains(&range.bytes),
            Some(bit) => range.bytes == 1 && bit < 8,
        };
        fits.then_some(Self { range, bit })
    }

    pub(super) fn write(self, to: &mut Writer<'_>) {
        self.range.write(to);
        to.u8(self.bit.unwrap_or(NO_BIT));
    }

    pub(super) fn read(from: &mut Reader<'_>) -> Option<Self> {
        let range = Range::read(from)?;
        Self::new(range, Some(from.u8()?).filter(|bit| *bit != NO_BIT))
    }
}
