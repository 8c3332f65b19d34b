//! The layout of a region, and the check that both ends mean the same one.
//!
//! A region begins with a header that never changes. The VMM writes it, from the partition file,
//! and each end compares it with what the partition file told *it* when it opens. After that the
//! header is not looked at again: all arithmetic uses the end's own copy, so that a peer that
//! changes its header later changes nothing.
//!
//! The number of slots is more than the depth. The spare ones are what a writer must fill before it
//! reaches the oldest message that a reader may be copying, so that an honest writer practically
//! never disturbs a reader.

use core::fmt;

use crate::memory::{Load, Store};
use crate::open::{Field, OpenError};

/// First field of every region: `"TKCH"`, little-endian.
pub const MAGIC: u32 = u32::from_le_bytes(*b"TKCH");
/// Version of the layout.
pub const VERSION: u32 = 1;
/// Longest message a channel can be made for, in bytes.
pub const MESSAGE_MAX: u32 = 64 * 1024;
/// Deepest queue, in messages.
pub const DEPTH_MAX: u32 = 1024;
/// Slots beyond the depth. Models have one only, so that laps come within few steps.
pub const SPARE: u32 = if cfg!(loom) { 1 } else { 3 };

/// Where things lie, in bytes from the start of the region, or of the slot.
pub mod offset {
    /// 32 bits: [`MAGIC`](super::MAGIC).
    pub const MAGIC: usize = 0;
    /// 32 bits: [`VERSION`](super::VERSION).
    pub const VERSION: usize = 4;
    /// 32 bits: [`Kind`](super::Kind).
    pub const KIND: usize = 8;
    /// 32 bits: [`Policy`](super::Policy), 0 in a sampling channel.
    pub const POLICY: usize = 12;
    /// 32 bits: longest message in bytes.
    pub const MAXIMUM: usize = 16;
    /// 32 bits: depth in messages, 1 in a sampling channel.
    pub const DEPTH: usize = 20;
    /// 32 bits: number of slots.
    pub const SLOTS: usize = 24;
    /// 64 bits: starts of the owner, modulo 2^64.
    pub const EPOCH: usize = 64;
    /// 64 bits, regions of messages: number of the first message of the owner's present life.
    pub const FIRST: usize = 72;
    /// 64 bits, acknowledgements: number of the message to be taken next.
    pub const READ: usize = 72;
    /// 64 bits, regions of messages: number of the message to be written next.
    pub const WRITTEN: usize = 80;
    /// Start of slot 0, and the length of an acknowledgement region.
    pub const SLOT: usize = 128;
    /// In a slot, 64 bits: for message `n`, `2n + 1` while it is written and `2n + 2` after.
    pub const SEQUENCE: usize = 0;
    /// In a slot, 64 bits: TSC given by the source.
    pub const STAMP: usize = 8;
    /// In a slot, 64 bits: length of the message in bytes.
    pub const LENGTH: usize = 16;
    /// In a slot: the message, filled up with zeros to a multiple of 8 bytes.
    pub const PAYLOAD: usize = 24;
}

/// Slots begin at multiples of this many bytes, a cache line.
const LINE: usize = 64;

/// The number of the 64-bit word at a byte offset.
pub(crate) const fn word(offset: usize) -> usize {
    offset / 8
}

/// What a region is.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Messages of a sampling channel.
    Sampling = 1,
    /// Messages of a queuing channel.
    Queuing = 2,
    /// Acknowledgement of a queuing channel.
    Acknowledgement = 3,
}

/// What happens to a message for a full queue.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// The source is told, and nothing is lost.
    Refuse = 1,
    /// It replaces the oldest one, and the destination is told.
    Overwrite = 2,
}

/// The shape of a channel as the partition file gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geometry {
    /// `None` is a sampling channel.
    pub(crate) policy: Option<Policy>,
    pub(crate) maximum: u32,
    pub(crate) depth: u32,
}

/// Why a channel cannot have this shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GeometryError {
    /// The longest message is not within 1 and [`MESSAGE_MAX`].
    Maximum(u32),
    /// The depth is not within 1 and [`DEPTH_MAX`].
    Depth(u32),
}

impl fmt::Display for GeometryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Maximum(n) => write!(f, "a message of {n} bytes: allowed is 1 to {MESSAGE_MAX}"),
            Self::Depth(n) => write!(f, "a depth of {n} messages: allowed is 1 to {DEPTH_MAX}"),
        }
    }
}

impl core::error::Error for GeometryError {}

impl Geometry {
    /// A sampling channel for messages of at most `maximum` bytes.
    ///
    /// # Errors
    /// [`GeometryError::Maximum`].
    pub const fn sampling(maximum: u32) -> Result<Self, GeometryError> {
        Self::checked(None, maximum, 1)
    }

    /// A queuing channel for `depth` messages of at most `maximum` bytes.
    ///
    /// # Errors
    /// See [`GeometryError`].
    pub const fn queuing(maximum: u32, depth: u32, policy: Policy) -> Result<Self, GeometryError> {
        Self::checked(Some(policy), maximum, depth)
    }

    const fn checked(
        policy: Option<Policy>,
        maximum: u32,
        depth: u32,
    ) -> Result<Self, GeometryError> {
        if maximum == 0 || maximum > MESSAGE_MAX {
            return Err(GeometryError::Maximum(maximum));
        }
        if depth == 0 || depth > DEPTH_MAX {
            return Err(GeometryError::Depth(depth));
        }
        Ok(Geometry { policy, maximum, depth })
    }

    /// Length of the source's region in bytes.
    #[must_use]
    pub const fn source_bytes(&self) -> usize {
        offset::SLOT + self.slots() as usize * self.slot_bytes()
    }

    /// Length of the destination's region in bytes: 0 for a sampling channel, which has none.
    #[must_use]
    pub const fn destination_bytes(&self) -> usize {
        if self.policy.is_some() { offset::SLOT } else { 0 }
    }

    /// Distance of two slots in bytes.
    #[must_use]
    pub const fn slot_bytes(&self) -> usize {
        (offset::PAYLOAD + self.maximum as usize).next_multiple_of(LINE)
    }

    /// Number of slots.
    #[must_use]
    pub const fn slots(&self) -> u32 {
        self.depth + SPARE
    }

    const fn source_kind(&self) -> Kind {
        if self.policy.is_some() { Kind::Queuing } else { Kind::Sampling }
    }

    /// The 32-bit fields of a header in the order of their offsets, from 0 without gaps.
    fn fields(&self, kind: Kind) -> [(Field, u32); 8] {
        let policy = self.policy.map_or(0, |p| p as u32);
        [
            (Field::Magic, MAGIC),
            (Field::Version, VERSION),
            (Field::Kind, kind as u32),
            (Field::Policy, policy),
            (Field::Maximum, self.maximum),
            (Field::Depth, self.depth),
            (Field::Slots, self.slots()),
            (Field::Reserved, 0),
        ]
    }

    /// Writes only the header of the source's region. A new region must be zero when it is
    /// handed over. To be called before the first start of the owner, and again before each
    /// further one, in case the owner has damaged it; what lies behind the header must then stay as
    /// it is.
    ///
    /// # Errors
    /// [`OpenError::TooSmall`].
    pub fn format_source(&self, region: &mut impl Store) -> Result<(), OpenError> {
        self.format(self.source_kind(), self.source_bytes(), region)
    }

    /// The same for the destination's region.
    ///
    /// # Errors
    /// [`OpenError::TooSmall`], [`OpenError::NotQueuing`].
    pub fn format_destination(&self, region: &mut impl Store) -> Result<(), OpenError> {
        self.queuing_policy()?;
        self.format(Kind::Acknowledgement, self.destination_bytes(), region)
    }

    fn format(&self, kind: Kind, bytes: usize, region: &mut impl Store) -> Result<(), OpenError> {
        long_enough(region, bytes)?;
        for (word, pair) in self.fields(kind).as_chunks::<2>().0.iter().enumerate() {
            let [(_, low), (_, high)] = *pair;
            region.store(word, u64::from(low) | u64::from(high) << 32);
        }
        Ok(())
    }

    pub(crate) fn check_source_length(&self, region: &impl Load) -> Result<(), OpenError> {
        long_enough(region, self.source_bytes())
    }

    pub(crate) fn check_destination_length(&self, region: &impl Load) -> Result<(), OpenError> {
        long_enough(region, self.destination_bytes())
    }

    pub(crate) fn check_source(&self, region: &impl Load) -> Result<(), OpenError> {
        self.check(self.source_kind(), self.source_bytes(), region)
    }

    pub(crate) fn check_destination(&self, region: &impl Load) -> Result<(), OpenError> {
        self.check(Kind::Acknowledgement, self.destination_bytes(), region)
    }

    fn check(&self, kind: Kind, bytes: usize, region: &impl Load) -> Result<(), OpenError> {
        long_enough(region, bytes)?;
        for (word, pair) in self.fields(kind).as_chunks::<2>().0.iter().enumerate() {
            let found = region.load(word);
            let halves = [found as u32, (found >> 32) as u32];
            for (&(field, expected), found) in pair.iter().zip(halves) {
                if found != expected {
                    return Err(OpenError::Header { field, expected, found });
                }
            }
        }
        Ok(())
    }

    pub(crate) fn queuing_policy(&self) -> Result<Policy, OpenError> {
        self.policy.ok_or(OpenError::NotQueuing)
    }

    pub(crate) fn must_be_sampling(&self) -> Result<(), OpenError> {
        if self.policy.is_some() { Err(OpenError::NotSampling) } else { Ok(()) }
    }
}

fn long_enough(region: &impl Load, needed: usize) -> Result<(), OpenError> {
    let given = region.words().saturating_mul(8);
    if given < needed { Err(OpenError::TooSmall { needed, given }) } else { Ok(()) }
}
