//! Each order comes back as it was written, and no message that is cut or lies is taken.

use super::super::{Area, MESSAGE_BYTES};
use super::*;

const RANGE: Range = Range { program: 2, area: Area::Output, offset: 70_000, bytes: 1 };

fn orders() -> [Order; 8] {
    let point = Point::new(RANGE, Some(7)).unwrap();
    [
        Order::Status { part: 7 },
        Order::WatchClear,
        Order::WatchAdd(Ranges::new(&[RANGE; RANGES_EACH + 1])),
        Order::WatchBegin { serial: 3, interval_ns: 1 << 40 },
        Order::Write { point, value: 1 },
        Order::Force { point, value: u64::MAX },
        Order::Release { point },
        Order::ReleaseAll,
    ]
}

#[test]
fn orders_of_a_change_are_read_as_they_were_written() {
    let prepare =
        Order::Prepare { program: 3, image_bytes: 70_000, forward_bytes: 96, back_bytes: 112 };
    let change = |step| Order::Change { program: 15, step };
    for order in [prepare, change(ChangeStep::Tell), change(ChangeStep::RollBack)] {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = order.encode(2, &mut buffer).unwrap();
        assert_eq!(decode_order(message), Ok((2, order)));
        for length in 8..message.len() {
            assert_eq!(decode_order(&message[..length]), Err(Some(2)));
        }
    }
    let mut buffer = [0; MESSAGE_BYTES];
    let message = change(ChangeStep::Commit).encode(2, &mut buffer).unwrap().to_vec();
    let unknown = [&message[..9], &[3]].concat();
    assert_eq!(decode_order(&unknown), Err(Some(2)));
}

#[test]
fn an_order_is_read_as_it_was_written_and_no_part_of_it_is_one() {
    for order in orders() {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = order.encode(9, &mut buffer).unwrap();
        assert_eq!(decode_order(message), Ok((9, order)));
        for length in 0..message.len() {
            let number = (length >= 8).then_some(9);
            assert_eq!(decode_order(&message[..length]), Err(number));
        }
        let mut longer = message.to_vec();
        longer.push(0);
        assert_eq!(decode_order(&longer), Err(Some(9)));
        assert_eq!(order.encode(9, &mut [0; 7]), None);
    }
}

#[test]
fn a_place_that_can_be_none_is_refused() {
    assert!(Point::new(Range { bytes: 9, ..RANGE }, None).is_none());
    assert!(Point::new(Range { bytes: 2, ..RANGE }, Some(1)).is_none());
    assert!(Point::new(RANGE, Some(8)).is_none());
    let mut buffer = [0; MESSAGE_BYTES];
    let point = Point::new(RANGE, None).unwrap();
    let message = Order::Release { point }.encode(9, &mut buffer).unwrap().to_vec();
    for (at, value) in [(9, 0), (9, 5), (10, 0), (10, 9)] {
        let mut changed = message.clone();
        changed[at] = value;
        assert_eq!(decode_order(&changed), Err(Some(9)), "byte {at} is {value}");
    }
}
