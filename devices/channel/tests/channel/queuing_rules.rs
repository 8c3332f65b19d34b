//! One test for each rule of the queuing port.

use takt_channel::{
    LengthError, Policy, QueuingDestination, ReceiveError, ReturnCode, SendError, Tsc,
};

use crate::memory::{Queue, Region};

const MAXIMUM: usize = 20;
const BOTH: [Policy; 2] = [Policy::Refuse, Policy::Overwrite];

/// The message and whether an overflow was told with it.
fn receive(
    destination: &mut QueuingDestination<Region, Region>,
) -> Result<(Vec<u8>, ReturnCode), ReceiveError> {
    let mut buffer = [0xee; MAXIMUM];
    let received = destination.receive(&mut buffer)?;
    Ok((received.bytes.to_vec(), received.code()))
}

fn ok(byte: u8) -> Result<(Vec<u8>, ReturnCode), ReceiveError> {
    Ok((vec![byte], ReturnCode::NoError))
}

#[test]
fn sending_an_empty_message_is_invalid_param() {
    let error = Queue::new(20, 1, Policy::Refuse).source().send(b"", Tsc(0)).unwrap_err();
    assert_eq!(error, SendError::Length(LengthError::Empty));
    assert_eq!(error.code(), ReturnCode::InvalidParam);
}

#[test]
fn sending_more_than_the_maximum_is_invalid_config() {
    let queue = Queue::new(20, 1, Policy::Refuse);
    let mut source = queue.source();
    assert_eq!(source.send(&[0; 21], Tsc(0)).unwrap_err().code(), ReturnCode::InvalidConfig);
    assert_eq!(source.status().waiting, 0);
}

#[test]
fn a_message_of_the_maximum_length_arrives_with_its_stamp() {
    let queue = Queue::new(20, 1, Policy::Refuse);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    source.send(&[7; MAXIMUM], Tsc(42)).unwrap();
    let mut buffer = [0; MAXIMUM];
    let received = destination.receive(&mut buffer).unwrap();
    assert_eq!((received.bytes, received.stamp), (&[7; MAXIMUM][..], Tsc(42)));
}

#[test]
fn messages_are_consumed_in_order_at_every_depth() {
    for policy in BOTH {
        for depth in [1, 2, 3, 7, 64] {
            let queue = Queue::new(20, depth, policy);
            let (mut source, mut destination) = (queue.source(), queue.destination());
            for round in 0..5 {
                for n in 0..depth as u8 {
                    source.send(&[n ^ round], Tsc(0)).unwrap();
                }
                for n in 0..depth as u8 {
                    assert_eq!(receive(&mut destination), ok(n ^ round));
                }
                assert_eq!(receive(&mut destination), Err(ReceiveError::Empty));
            }
        }
    }
}

#[test]
fn an_empty_queue_is_not_available() {
    let queue = Queue::new(20, 1, Policy::Refuse);
    let error = receive(&mut queue.destination()).unwrap_err();
    assert_eq!((error, error.code()), (ReceiveError::Empty, ReturnCode::NotAvailable));
}

#[test]
fn a_full_queue_that_refuses_is_not_available_and_loses_nothing() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    source.send(b"1", Tsc(0)).unwrap();
    source.send(b"2", Tsc(0)).unwrap();
    for _ in 0..10 {
        let error = source.send(b"x", Tsc(0)).unwrap_err();
        assert_eq!((error, error.code()), (SendError::Full, ReturnCode::NotAvailable));
    }
    assert_eq!(receive(&mut destination), ok(b'1'));
    source.send(b"3", Tsc(0)).unwrap();
    assert_eq!(receive(&mut destination), ok(b'2'));
    assert_eq!(receive(&mut destination), ok(b'3'));
    assert_eq!(destination.status().counters.lost, 0);
}

#[test]
fn after_an_overflow_the_next_message_is_delivered_with_invalid_config_once() {
    for depth in [1, 2, 5] {
        let queue = Queue::new(20, depth, Policy::Overwrite);
        let (mut source, mut destination) = (queue.source(), queue.destination());
        let sent = depth as u8 + 9;
        for n in 0..sent {
            source.send(&[n], Tsc(0)).unwrap();
        }
        assert_eq!(receive(&mut destination), Ok((vec![9], ReturnCode::InvalidConfig)));
        for n in 10..sent {
            assert_eq!(receive(&mut destination), ok(n));
        }
        assert_eq!(receive(&mut destination), Err(ReceiveError::Empty));
        assert_eq!(destination.status().counters.lost, 9);
        source.send(&[1], Tsc(0)).unwrap();
        assert_eq!(receive(&mut destination), ok(1));
    }
}

#[test]
fn a_full_queue_that_overwrites_has_lost_nothing_yet() {
    let queue = Queue::new(20, 3, Policy::Overwrite);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    (0..3).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
    (0..3).for_each(|n| assert_eq!(receive(&mut destination), ok(n)));
}

#[test]
fn clear_empties_the_queue_and_makes_room() {
    for policy in BOTH {
        let queue = Queue::new(20, 2, policy);
        let (mut source, mut destination) = (queue.source(), queue.destination());
        (0..2).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
        destination.clear();
        assert_eq!(receive(&mut destination), Err(ReceiveError::Empty));
        (2..4).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
        (2..4).for_each(|n| assert_eq!(receive(&mut destination), ok(n)));
    }
}

#[test]
fn clear_forgets_an_overflow_and_keeps_the_count() {
    let queue = Queue::new(20, 2, Policy::Overwrite);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    (0..5).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
    destination.clear();
    source.send(&[9], Tsc(0)).unwrap();
    assert_eq!(receive(&mut destination), ok(9));
    assert_eq!(destination.status().counters.lost, 3);
}

#[test]
fn status_tells_waiting_depth_maximum_and_policy_at_both_ends() {
    let queue = Queue::new(20, 2, Policy::Overwrite);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    for sent in 1..5 {
        source.send(b"x", Tsc(0)).unwrap();
        let (s, d) = (source.status(), destination.status());
        assert_eq!(
            (s.waiting, s.depth, s.maximum, s.policy),
            (sent.min(2), 2, 20, Policy::Overwrite)
        );
        assert_eq!(
            (d.waiting, d.depth, d.maximum, d.policy),
            (sent.min(2), 2, 20, Policy::Overwrite)
        );
    }
}

#[test]
fn opening_either_end_empties_the_queue() {
    for policy in BOTH {
        let queue = Queue::new(20, 2, policy);
        let (mut source, mut destination) = (queue.source(), queue.destination());
        (0..2).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
        let mut source = {
            drop(source);
            queue.source()
        };
        assert_eq!(receive(&mut destination), Err(ReceiveError::Empty));
        (2..4).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
        drop(destination);
        let mut destination = queue.destination();
        assert_eq!(receive(&mut destination), Err(ReceiveError::Empty));
        (4..6).for_each(|n| source.send(&[n], Tsc(0)).unwrap());
        (4..6).for_each(|n| assert_eq!(receive(&mut destination), ok(n)));
        assert_eq!(source.status().counters.peer_starts, 1);
        assert_eq!(source.status().counters.hostile + destination.status().counters.hostile, 0);
    }
}

#[test]
fn a_start_of_the_other_end_is_noticed() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    let mut destination = queue.destination();
    assert_eq!(destination.status().peer_epoch, 0);
    let mut source = queue.source();
    assert_eq!(
        (destination.status().peer_epoch, destination.status().counters.peer_starts),
        (1, 1)
    );
    drop(destination);
    queue.destination();
    assert_eq!((source.status().peer_epoch, source.status().counters.peer_starts), (2, 1));
}

#[test]
fn a_buffer_below_the_maximum_is_invalid_param_and_consumes_nothing() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    source.send(b"x", Tsc(0)).unwrap();
    let error = destination.receive(&mut [0; MAXIMUM - 1]).unwrap_err();
    assert_eq!((error, error.code()), (ReceiveError::Buffer(20), ReturnCode::InvalidParam));
    assert_eq!(receive(&mut destination), ok(b'x'));
}
