//! What one end tells the other: a message of the line.
//!
//! Each message has two 32-bit numbers, little-endian: the kind and the connection. Data follows them.

/// Longest message of the line.
pub(crate) const MESSAGE_MAX: usize = 4096;
/// Bytes before the data.
const HEADER: usize = 8;
/// Most bytes of data in a frame.
pub const PAYLOAD_MAX: usize = MESSAGE_MAX - HEADER;

/// A frame. The number is that of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// Takt answers inside; from now on connections make sense.
    Ready,
    /// A client has connected outside.
    Open(u32),
    /// Bytes of the connection.
    Data(u32, &'a [u8]),
    /// So many bytes more may be sent.
    Room(u32, u32),
    /// No further data comes.
    End(u32),
    /// The connection is over at the other end: no data comes, and none is taken.
    Gone(u32),
}

impl<'a> Frame<'a> {
    /// Reads a message; `None` for one that is no frame.
    #[must_use]
    pub fn parse(message: &'a [u8]) -> Option<Self> {
        let (header, data) = message.split_at_checked(HEADER)?;
        let (kind, connection) = (number(header, 0)?, number(header, 4)?);
        match (kind, data) {
            (0, []) if connection == 0 => Some(Self::Ready),
            (1, []) => Some(Self::Open(connection)),
            (2, [_, ..]) => Some(Self::Data(connection, data)),
            (3, _) if data.len() == 4 => Some(Self::Room(connection, number(data, 0)?)),
            (4, []) => Some(Self::End(connection)),
            (5, []) => Some(Self::Gone(connection)),
            _ => None,
        }
    }

    /// Makes the message; `None` if there is no data, or too much.
    #[must_use]
    pub fn message(self) -> Option<Vec<u8>> {
        let bytes;
        let (kind, connection, data): (u32, u32, &[u8]) = match self {
            Self::Ready => (0, 0, &[]),
            Self::Open(connection) => (1, connection, &[]),
            Self::Data(connection, data) => (2, connection, data),
            Self::Room(connection, room) => {
                bytes = room.to_le_bytes();
                (3, connection, &bytes)
            }
            Self::End(connection) => (4, connection, &[]),
            Self::Gone(connection) => (5, connection, &[]),
        };
        let fits = data.len() <= PAYLOAD_MAX && (kind != 2 || !data.is_empty());
        fits.then(|| [&kind.to_le_bytes(), &connection.to_le_bytes(), data].concat())
    }
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|four| u32::from_le_bytes(*four))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_frame_is_read_as_it_was_made() {
        let all = [
            Frame::Ready,
            Frame::Open(1),
            Frame::Data(u32::MAX, b"x"),
            Frame::Data(2, &[7; PAYLOAD_MAX]),
            Frame::Room(3, u32::MAX),
            Frame::End(4),
            Frame::Gone(5),
        ];
        for frame in all {
            let message = frame.message().unwrap();
            assert_eq!(Frame::parse(&message), Some(frame));
            assert!(message.len() <= MESSAGE_MAX);
        }
    }

    #[test]
    fn what_is_no_frame_is_not_read_and_not_made() {
        assert_eq!(Frame::Data(1, b"").message(), None);
        assert_eq!(Frame::Data(1, &[0; PAYLOAD_MAX + 1]).message(), None);
        let header = |kind: u8| vec![kind, 0, 0, 0, 1, 0, 0, 0];
        for kind in [0, 2, 3, 6, 255] {
            assert_eq!(Frame::parse(&header(kind)), None, "{kind}");
        }
        for kind in [1, 4, 5] {
            assert_eq!(Frame::parse(&[header(kind), vec![1]].concat()), None, "{kind} with data");
        }
        assert_eq!(Frame::parse(&[header(3), vec![0; 5]].concat()), None);
        assert!((0..8).all(|length| Frame::parse(&header(1)[..length]).is_none()));
    }
}
