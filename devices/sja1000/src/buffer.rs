//! How a frame lies in the transmit and receive buffers: data sheet, sections 6.4.13 and 6.4.14.
//!
//! Both begin with a byte of format and length, then two bytes of identifier in a standard frame
//! and four in an extended one, left-aligned, then the data.

use crate::frame::{ExtendedId, Frame, Id, StandardId};

/// Bytes of either buffer.
pub(crate) const BYTES: usize = 13;

/// Bits of the first byte.
const EXTENDED: u8 = 1 << 7;
const REMOTE: u8 = 1 << 6;
const LENGTH: u8 = 0xf;

/// Bytes of a frame whose first byte is `first`, 3 to 13.
///
/// The length code on the bus has four bits and may say up to 15; there are 8 data bytes then.
pub(crate) fn length(first: u8) -> usize {
    let header = if first & EXTENDED == 0 { 3 } else { 5 };
    let data = if first & REMOTE == 0 { (first & LENGTH).min(8) } else { 0 };
    header + usize::from(data)
}

/// The bytes of a frame; those beyond its [`length`] mean nothing.
pub(crate) fn encode(frame: &Frame) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    let remote = if frame.is_remote() { REMOTE } else { 0 };
    let data = match frame.id() {
        Id::Standard(id) => {
            bytes[0] = remote | frame.length();
            bytes[1..3].copy_from_slice(&(id.get() << 5).to_be_bytes());
            &mut bytes[3..]
        }
        Id::Extended(id) => {
            bytes[0] = EXTENDED | remote | frame.length();
            bytes[1..5].copy_from_slice(&(id.get() << 3).to_be_bytes());
            &mut bytes[5..]
        }
    };
    for (to, from) in data.iter_mut().zip(frame.bytes()) {
        *to = *from;
    }
    bytes
}

/// The frame that these bytes are: any are one. Those beyond its [`length`] are zero.
pub(crate) fn decode(bytes: &[u8; BYTES]) -> Frame {
    let [first, a, b, c, d, ..] = *bytes;
    let (id, data) = if first & EXTENDED == 0 {
        let id = u16::from_be_bytes([a, b]) >> 5;
        (Id::Standard(StandardId::truncated(id)), &bytes[3..])
    } else {
        let id = u32::from_be_bytes([a, b, c, d]) >> 3;
        (Id::Extended(ExtendedId::truncated(id)), &bytes[5..])
    };
    Frame::received(id, first & REMOTE != 0, first & LENGTH, data)
}
