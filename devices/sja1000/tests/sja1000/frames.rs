//! Frames on their way out and in.

use proptest::prelude::*;
use takt_sja1000::{
    ExtendedId, Frame, Id, IdError, LengthError, ReceiveError, StandardId, TransmitError,
};

use crate::chip::Chip;

fn standard(id: u16) -> StandardId {
    StandardId::new(id).unwrap()
}

fn extended(id: u32) -> ExtendedId {
    ExtendedId::new(id).unwrap()
}

#[test]
fn only_what_the_bus_can_carry_can_be_made() {
    assert_eq!(StandardId::new(0x800), Err(IdError { id: 0x800, maximum: 0x7ff }));
    let too_large = IdError { id: 0x2000_0000, maximum: 0x1fff_ffff };
    assert_eq!(ExtendedId::new(0x2000_0000), Err(too_large));
    assert_eq!(Frame::data(standard(1), &[0; 9]), Err(LengthError { bytes: 9 }));
    assert_eq!(Frame::remote(standard(1), 9), Err(LengthError { bytes: 9 }));
    assert_ne!(Id::from(standard(1)), Id::from(extended(1)));
}

/// The layout of the data sheet, byte by byte: bytes beyond the frame are not written.
#[test]
fn each_format_is_written_as_the_data_sheet_says() {
    let chip = Chip::new();
    let mut controller = chip.start();
    let frames: [(Frame, &[u8]); 5] = [
        (Frame::data(standard(0x7a5), &[]).unwrap(), &[0x00, 0xf4, 0xa0]),
        (Frame::data(standard(0x123), &[9, 8, 7]).unwrap(), &[0x03, 0x24, 0x60, 9, 8, 7]),
        (Frame::remote(standard(0x001), 8).unwrap(), &[0x48, 0x00, 0x20]),
        (
            Frame::data(extended(0x1234_5678), &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap(),
            &[0x88, 0x91, 0xa2, 0xb3, 0xc0, 1, 2, 3, 4, 5, 6, 7, 8],
        ),
        (Frame::remote(extended(0x1fff_ffff), 0).unwrap(), &[0xc0, 0xff, 0xff, 0xff, 0xf8]),
    ];
    for (frame, expected) in frames {
        chip.inside().transmit_buffer = [0x5a; 13];
        controller.transmit(&frame).unwrap();
        let sent = chip.inside().sent.pop().unwrap();
        let (bytes, rest) = sent.split_at(expected.len());
        assert_eq!(bytes, expected, "{frame:?}");
        assert!(rest.iter().all(|&byte| byte == 0x5a), "{frame:?}: {sent:x?}");
    }
    assert_eq!(chip.inside().violations, [""; 0]);
}

#[test]
fn a_busy_buffer_is_left_alone() {
    let chip = Chip::new();
    let mut controller = chip.start();
    chip.inside().alone = true;
    let first = Frame::data(standard(1), &[1]).unwrap();
    let second = Frame::data(standard(2), &[2]).unwrap();
    assert_eq!(controller.transmit(&first), Ok(()));
    let before = chip.inside().transmit_buffer;
    chip.inside().accesses = 0;
    assert_eq!(controller.transmit(&second), Err(TransmitError::Busy));
    assert_eq!(chip.inside().accesses, 1);
    assert_eq!(chip.inside().transmit_buffer, before);
    chip.inside().pending = false;
    assert_eq!(controller.transmit(&second), Ok(()));
}

#[test]
fn frames_come_in_order_and_then_none() {
    let chip = Chip::new();
    let mut controller = chip.start();
    chip.deliver(&[0x02, 0x24, 0x60, 5, 6]);
    chip.deliver(&[0x80, 0x91, 0xa2, 0xb3, 0xc0]);
    assert_eq!(controller.receive(), Ok(Frame::data(standard(0x123), &[5, 6]).unwrap()));
    assert_eq!(controller.receive(), Ok(Frame::data(extended(0x1234_5678), &[]).unwrap()));
    chip.inside().accesses = 0;
    assert_eq!(controller.receive(), Err(ReceiveError::Empty));
    assert_eq!(chip.inside().accesses, 1);
}

/// The length code has four bits; the frame has eight bytes all the same.
#[test]
fn a_length_code_above_eight_means_eight() {
    let chip = Chip::new();
    let mut controller = chip.start();
    chip.deliver(&[0x0f, 0x24, 0x60, 1, 2, 3, 4, 5, 6, 7, 8]);
    chip.inside().accesses = 0;
    let frame = controller.receive().unwrap();
    // The status, the bytes of the frame and no others, the release.
    assert_eq!(chip.inside().accesses, 1 + 11 + 1);
    assert_eq!((frame.length(), frame.bytes()), (8, &[1, 2, 3, 4, 5, 6, 7, 8][..]));
    chip.deliver(&[0x4f, 0x24, 0x60]);
    let frame = controller.receive().unwrap();
    assert_eq!((frame.is_remote(), frame.length(), frame.bytes()), (true, 8, &[][..]));
}

#[test]
fn an_overrun_is_counted_once_and_the_rest_is_received() {
    let chip = Chip::new();
    let mut controller = chip.start();
    // 21 of them fill 63 bytes of 64.
    for number in 0..25 {
        chip.deliver(&[0x00, number, 0x00]);
    }
    let mut received = 0;
    while controller.receive().is_ok() {
        received += 1;
    }
    assert_eq!(received, takt_sja1000::RECEIVE_BUFFER_FRAMES);
    assert_eq!(controller.overruns(), 1);
    assert!(!chip.inside().overrun);
    chip.inside().overrun = true;
    assert_eq!(controller.receive(), Err(ReceiveError::Empty));
    assert_eq!(controller.overruns(), 2);
}

fn frames() -> impl Strategy<Value = Frame> {
    let ids = prop_oneof![
        (0u16..0x800).prop_map(|id| Id::from(standard(id))),
        (0u32..0x2000_0000).prop_map(|id| Id::from(extended(id))),
    ];
    (ids, any::<bool>(), prop::collection::vec(any::<u8>(), 0..=8)).prop_map(
        |(id, remote, bytes)| {
            if remote { Frame::remote(id, bytes.len() as u8) } else { Frame::data(id, &bytes) }
                .unwrap()
        },
    )
}

proptest! {
    #[test]
    fn what_is_sent_is_what_is_received(frame in frames()) {
        let chip = Chip::new();
        let mut controller = chip.start();
        controller.transmit(&frame).unwrap();
        let sent = chip.inside().sent.pop().unwrap();
        let header = if sent[0] & 0x80 == 0 { 3 } else { 5 };
        chip.deliver(&sent[..header + frame.bytes().len()]);
        prop_assert_eq!(controller.receive(), Ok(frame));
    }
}
