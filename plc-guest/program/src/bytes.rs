//! Little-endian numbers out of a record.

/// The bytes of one record. They are as many as its layout says, so reading never fails; outside of
/// them are zeros.
#[derive(Clone, Copy)]
pub(crate) struct Record<'a> {
    bytes: &'a [u8],
    /// Where the record lies in the image, for errors.
    pub offset: u64,
}

impl<'a> Record<'a> {
    pub const fn new(bytes: &'a [u8], offset: u64) -> Self {
        Self { bytes, offset }
    }

    /// All of its bytes.
    #[cfg(feature = "hash")]
    pub const fn bytes(self) -> &'a [u8] {
        self.bytes
    }

    fn array<const N: usize>(self, at: usize) -> [u8; N] {
        self.bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
    }

    pub fn u8(self, at: usize) -> u8 {
        u8::from_le_bytes(self.array(at))
    }

    pub fn u16(self, at: usize) -> u16 {
        u16::from_le_bytes(self.array(at))
    }

    pub fn u32(self, at: usize) -> u32 {
        u32::from_le_bytes(self.array(at))
    }

    pub fn u64(self, at: usize) -> u64 {
        u64::from_le_bytes(self.array(at))
    }

    pub fn i64(self, at: usize) -> i64 {
        i64::from_le_bytes(self.array(at))
    }

    /// A reference to a string: its offset in the strings and its length.
    pub fn text(self, at: usize) -> (u32, u32) {
        (self.u32(at), self.u32(at + 4))
    }
}
