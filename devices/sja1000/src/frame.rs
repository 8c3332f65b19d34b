//! Frames and their identifiers, valid by construction.

use core::fmt;

/// Most data bytes of a frame (CAN specification 2.0).
const DATA_MAX: usize = 8;

/// An identifier of 11 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StandardId(u16);

impl StandardId {
    /// The largest, 11 ones.
    pub const MAX: Self = Self(0x7ff);

    /// # Errors
    /// [`IdError`] if it has more than 11 bits.
    pub const fn new(id: u16) -> Result<Self, IdError> {
        if id > Self::MAX.0 {
            return Err(IdError { id: id as u32, maximum: Self::MAX.0 as u32 });
        }
        Ok(Self(id))
    }

    /// The lowest 11 bits of `id`.
    pub(crate) const fn truncated(id: u16) -> Self {
        Self(id & Self::MAX.0)
    }

    /// As a number.
    #[must_use]
    pub const fn get(self) -> u16 {
        self.0
    }
}

/// An identifier of 29 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ExtendedId(u32);

impl ExtendedId {
    /// The largest, 29 ones.
    pub const MAX: Self = Self(0x1fff_ffff);

    /// # Errors
    /// [`IdError`] if it has more than 29 bits.
    pub const fn new(id: u32) -> Result<Self, IdError> {
        if id > Self::MAX.0 {
            return Err(IdError { id, maximum: Self::MAX.0 });
        }
        Ok(Self(id))
    }

    /// The lowest 29 bits of `id`.
    pub(crate) const fn truncated(id: u32) -> Self {
        Self(id & Self::MAX.0)
    }

    /// As a number.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }
}

/// What a frame is called on the bus. A standard and an extended identifier are never the same,
/// whatever their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Id {
    /// 11 bits.
    Standard(StandardId),
    /// 29 bits.
    Extended(ExtendedId),
}

impl From<StandardId> for Id {
    fn from(id: StandardId) -> Self {
        Self::Standard(id)
    }
}

impl From<ExtendedId> for Id {
    fn from(id: ExtendedId) -> Self {
        Self::Extended(id)
    }
}

/// An identifier with too many bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdError {
    /// What was asked for.
    pub id: u32,
    /// The largest of its kind.
    pub maximum: u32,
}

impl fmt::Display for IdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "identifier {:#x} is above {:#x}", self.id, self.maximum)
    }
}

impl core::error::Error for IdError {}

/// A frame that is longer than CAN allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LengthError {
    /// The bytes that were asked for.
    pub bytes: usize,
}

impl fmt::Display for LengthError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a frame has at most {DATA_MAX} data bytes, not {}", self.bytes)
    }
}

impl core::error::Error for LengthError {}

/// A data frame or a remote frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: Id,
    remote: bool,
    length: u8,
    /// Zero beyond `length`, and in a remote frame.
    data: [u8; DATA_MAX],
}

impl Frame {
    /// A frame with data.
    ///
    /// # Errors
    /// [`LengthError`] if there are more than 8 bytes.
    pub fn data(id: impl Into<Id>, bytes: &[u8]) -> Result<Self, LengthError> {
        let mut data = [0; DATA_MAX];
        let part = data.get_mut(..bytes.len()).ok_or(LengthError { bytes: bytes.len() })?;
        part.copy_from_slice(bytes);
        Ok(Self { id: id.into(), remote: false, length: bytes.len() as u8, data })
    }

    /// A frame that asks for the data frame of the same identifier, which has `length` bytes.
    ///
    /// # Errors
    /// [`LengthError`] if that is more than 8.
    pub fn remote(id: impl Into<Id>, length: u8) -> Result<Self, LengthError> {
        if usize::from(length) > DATA_MAX {
            return Err(LengthError { bytes: length.into() });
        }
        Ok(Self { id: id.into(), remote: true, length, data: [0; DATA_MAX] })
    }

    /// A frame as it was on the bus, where a length code above 8 means 8. `bytes` are zero beyond
    /// the length, and in a remote frame.
    pub(crate) fn received(id: Id, remote: bool, length: u8, bytes: &[u8]) -> Self {
        let mut data = [0; DATA_MAX];
        for (to, from) in data.iter_mut().zip(bytes) {
            *to = *from;
        }
        Self { id, remote, length: length.min(DATA_MAX as u8), data }
    }

    /// Its identifier.
    #[must_use]
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Whether it asks for data instead of having some.
    #[must_use]
    pub const fn is_remote(&self) -> bool {
        self.remote
    }

    /// Its data length code, 0 to 8: of a remote frame, the bytes that it asks for.
    #[must_use]
    pub const fn length(&self) -> u8 {
        self.length
    }

    /// Its data; none in a remote frame.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        let bytes = if self.remote { 0 } else { self.length.into() };
        self.data.get(..bytes).unwrap_or_default()
    }
}
