//! What leaves by a port on the host: a header and the message, as one packet or one record.
//!
//! A tool wants to know when a message was sent without knowing the time-stamp counter, and whether
//! it is still good. The length is there for files, which keep no boundaries; a file of such
//! records can also be sent from, so that what one run has recorded another one can hear.

/// Bytes of the header.
pub const HEADER: usize = 24;

/// What a packet says of its message. All fields are little-endian, in this order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// When Takt took the message from the channel, in nanoseconds since the run's epoch.
    pub taken_ns: u64,
    /// How old it was then, by what its source says.
    pub age_ns: u64,
    /// [`VALID`] and [`LOST`].
    pub flags: u32,
    /// Length of the message in bytes.
    pub length: u32,
}

/// The message was at most as old as the refresh period; only of sampling channels.
pub const VALID: u32 = 1;
/// Messages before this one were overwritten; only of queuing channels.
pub const LOST: u32 = 2;

impl Header {
    /// As it is written.
    #[must_use]
    pub fn to_bytes(self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        let [first, second, third] =
            [self.taken_ns, self.age_ns, u64::from(self.flags) | u64::from(self.length) << 32]
                .map(u64::to_le_bytes);
        bytes[..8].copy_from_slice(&first);
        bytes[8..16].copy_from_slice(&second);
        bytes[16..].copy_from_slice(&third);
        bytes
    }

    /// As it is read; every value is one, and nothing of it need be true.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; HEADER]) -> Self {
        let word = |start: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[start..start + 8]);
            u64::from_le_bytes(word)
        };
        let last = word(16);
        Self { taken_ns: word(0), age_ns: word(8), flags: last as u32, length: (last >> 32) as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_lie_where_the_documentation_says() {
        let header = Header { taken_ns: 1, age_ns: 0x0203, flags: VALID | LOST, length: 4 };
        let mut expected = [0; HEADER];
        (expected[0], expected[8], expected[9]) = (1, 3, 2);
        (expected[16], expected[20]) = (3, 4);
        assert_eq!(header.to_bytes(), expected);
        assert_eq!(Header::from_bytes(&expected), header);
    }
}
