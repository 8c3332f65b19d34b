//! A block as it lies in a file.
//!
//! ```text
//!  0  magic "TAKTKEEP"          8 bytes
//!  8  version 1                 u32
//! 12  number of values          u32
//! 16  bytes, with the checksum  u64
//! 24  generation, from 1        u64
//! 32  cycle of the values       u64
//! 40  SHA-256 of the image      32 bytes
//! 72  the values: lengths of name and type (u16, u16), count (u32), lowest index (i64), bytes of an element (u32),
//!     zero (u32), then name, type, bytes
//!     SHA-256 of all before     32 bytes
//! ```
//!
//! Numbers are little-endian. The checksum is looked at before anything else is believed. What comes behind it is
//! left over from a longer generation, and is not read.

use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::layout::{Layout, Part};

const MAGIC: &[u8; 8] = b"TAKTKEEP";
const VERSION: u32 = 1;
const HEAD: usize = 72;
const VALUE_HEAD: usize = 24;
const CHECKSUM: usize = 32;
/// Most bytes of a generation.
pub const LENGTH_MAX: u64 = 4 << 20;

/// Why a file has no whole generation.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[expect(missing_docs, reason = "each says what it is about")]
pub enum Damage {
    #[error("it has {0} bytes, which are no whole generation")]
    Short(u64),
    #[error("it does not begin as a file of retained values")]
    Magic,
    #[error("it is of version {0}, and this Takt reads version {VERSION}")]
    Version(u32),
    #[error("it says that its generation has {0} bytes, of at most {LENGTH_MAX}")]
    Length(u64),
    #[error("its checksum is wrong")]
    Checksum,
    #[error("its values do not fit into it")]
    Values,
    #[error("its generation has the number {0}, which no file gets to")]
    Number(u64),
    #[error("it is empty, and had a generation")]
    Empty,
    #[error("it cannot be read: {0}")]
    Unreadable(String),
}

/// A value in a file, or an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// As [`Part::name`].
    pub name: String,
    /// As [`Part::ty`].
    pub ty: String,
    /// As [`Part::lower`].
    pub lower: i64,
    /// As [`Part::count`].
    pub count: u32,
    /// As [`Part::bytes`].
    pub bytes: u32,
    /// All elements.
    pub value: Vec<u8>,
}

/// All values of one cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Generation {
    /// Each has a higher one than that before it.
    pub number: u64,
    /// Number of the window's release after which the values were copied.
    pub cycle: u64,
    /// SHA-256 of the image that ran.
    pub image: [u8; 32],
    /// The values.
    pub entries: Vec<Entry>,
}

/// How long a generation with these values is.
pub(crate) fn bytes(parts: &[Part]) -> u64 {
    let value = |part: &Part| {
        (VALUE_HEAD + part.name.len() + part.ty.len()) as u64
            + u64::from(part.count) * u64::from(part.bytes)
    };
    (HEAD + CHECKSUM) as u64 + parts.iter().map(value).sum::<u64>()
}

impl Generation {
    /// A block of this layout as it lies in a file; nothing if it is none.
    #[must_use]
    pub fn encode(number: u64, cycle: u64, layout: &Layout, block: &[u8]) -> Option<Vec<u8>> {
        let length = layout.file_bytes();
        if block.len() != layout.initial().len() || length > LENGTH_MAX {
            return None;
        }
        let mut to = Vec::with_capacity(length as usize);
        to.extend_from_slice(MAGIC);
        to.extend_from_slice(&VERSION.to_le_bytes());
        to.extend_from_slice(&(layout.parts().len() as u32).to_le_bytes());
        for word in [length, number, cycle] {
            to.extend_from_slice(&word.to_le_bytes());
        }
        to.extend_from_slice(&layout.image());
        for part in layout.parts() {
            to.extend_from_slice(&u16::try_from(part.name.len()).ok()?.to_le_bytes());
            to.extend_from_slice(&u16::try_from(part.ty.len()).ok()?.to_le_bytes());
            to.extend_from_slice(&part.count.to_le_bytes());
            to.extend_from_slice(&part.lower.to_le_bytes());
            to.extend_from_slice(&part.bytes.to_le_bytes());
            to.extend_from_slice(&[0; 4]);
            to.extend_from_slice(part.name.as_bytes());
            to.extend_from_slice(part.ty.as_bytes());
            to.extend_from_slice(block.get(part.range())?);
        }
        let checksum = Sha256::digest(&to);
        to.extend_from_slice(&checksum);
        Some(to)
    }

    /// The generation at the start of these bytes.
    ///
    /// # Errors
    /// Why there is none.
    pub fn decode(file: &[u8]) -> Result<Self, Damage> {
        let short = || Damage::Short(file.len() as u64);
        let mut head = Reader(file.get(..HEAD).ok_or_else(short)?);
        if head.take(MAGIC.len()) != Some(&MAGIC[..]) {
            return Err(Damage::Magic);
        }
        let version = head.u32().ok_or_else(short)?;
        if version != VERSION {
            return Err(Damage::Version(version));
        }
        let count = head.u32().ok_or_else(short)?;
        let length = head.u64().ok_or_else(short)?;
        if length > LENGTH_MAX || length < (HEAD + CHECKSUM) as u64 {
            return Err(Damage::Length(length));
        }
        let whole = file.get(..length as usize).ok_or_else(short)?;
        let (content, checksum) = whole.split_at(whole.len() - CHECKSUM);
        if Sha256::digest(content).as_slice() != checksum {
            return Err(Damage::Checksum);
        }
        let (number, cycle) = (head.u64().ok_or_else(short)?, head.u64().ok_or_else(short)?);
        // The next one's is one higher, and 0 is that of none.
        if matches!(number, 0 | u64::MAX) {
            return Err(Damage::Number(number));
        }
        let image = head.array().ok_or_else(short)?;
        let mut values = Reader(&content[HEAD..]);
        // The list grows by what is there, not by what is said.
        let mut entries = Vec::new();
        for _ in 0..count {
            entries.push(Entry::read(&mut values).ok_or(Damage::Values)?);
        }
        let rest = values.0.len();
        if rest == 0 { Ok(Self { number, cycle, image, entries }) } else { Err(Damage::Values) }
    }
}

impl Entry {
    fn read(from: &mut Reader<'_>) -> Option<Self> {
        let (name, ty) = (from.u16()?, from.u16()?);
        let (count, lower) = (from.u32()?, from.u64()?.cast_signed());
        let (bytes, _) = (from.u32()?, from.u32()?);
        let name = std::str::from_utf8(from.take(name.into())?).ok()?.to_owned();
        let ty = std::str::from_utf8(from.take(ty.into())?).ok()?.to_owned();
        let length = (count as usize).checked_mul(bytes as usize)?;
        let value = from.take(length)?.to_vec();
        Some(Self { name, ty, lower, count, bytes, value })
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(bytes)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }
}
