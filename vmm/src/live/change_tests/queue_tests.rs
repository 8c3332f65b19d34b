//! A change of a PLC whose kernel takes few orders.

use super::*;

/// A window each 200 ms, in which the kernel takes four orders.
#[test]
fn questions_leave_room_for_orders_in_the_queue_of_a_slow_kernel() {
    let mut plant = Plant::new("slow");
    let (mut orders, mut answers) = plant.case.guest();
    plant.tick();
    plant.load(&image(1, 2, 10_000)).unwrap();
    let mut buffer = [0; MESSAGE_BYTES];
    let mut tells = 0;
    for window in 0..50 {
        for _ in 0..10 {
            plant.tick();
        }
        let mut taken = 0;
        while taken < 4
            && let Ok(message) = orders.receive(&mut buffer)
        {
            taken += 1;
            let (number, order) = decode_order(message.bytes).unwrap();
            tells += u32::from(matches!(order, Order::Change { step: ChangeStep::Tell, .. }));
            let answer = match order {
                Order::Change { .. } => Answer::Change(record(Phase::Prepared)),
                _ => Answer::Reply(Ok(())),
            };
            // An answer that is lost ends nothing.
            if window % 8 != 7 {
                let answer = answer.encode(number, &mut buffer).unwrap();
                answers.send(answer, takt_channel::Tsc(1)).unwrap();
            }
        }
        assert!(orders.receive(&mut buffer).is_err(), "orders are left after window {window}");
    }
    assert!((40..=50).contains(&tells), "{tells}");
    assert_eq!(plant.phase().1, "prepared");
    // The guest starts anew, and answers nothing of what the one before was asked.
    let (mut orders, _answers) = plant.case.guest();
    plant.tick();
    let message = orders.receive(&mut buffer).unwrap();
    assert!(matches!(decode_order(message.bytes), Ok((_, Order::Status { part: 0 }))));
}
