//! A sample comes back as it was written.

use super::*;

#[test]
fn a_part_is_read_as_it_was_written_and_nothing_else_is_one() {
    let head = SampleHead {
        serial: 1,
        cycle: 2,
        release_tsc: 3,
        time_ns: 0x1234_5678_9abc,
        missed: 4,
        part: 5,
        last: true,
        unsettled: 6,
        bytes: PAYLOAD_BYTES as u16,
    };
    let mut buffer = [0; MESSAGE_BYTES];
    let message = head.encode(|payload| payload.fill(7), &mut buffer).unwrap();
    assert_eq!(SampleHead::decode(message), Some((head, &[7; PAYLOAD_BYTES][..])));
    assert_eq!(SampleHead::decode(&message[..message.len() - 1]), None);
    assert_eq!(super::super::decode_answer(message), None, "it is a sample");
    let long = SampleHead { bytes: head.bytes + 1, ..head };
    assert_eq!(long.encode(|_| {}, &mut buffer), None);
}
