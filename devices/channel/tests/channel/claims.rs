//! Each claim that cannot be true, one at a time: told, counted, stepped over.

use takt_channel::{
    Claim, Geometry, Policy, ReadError, ReceiveError, ReturnCode, SamplingDestination,
    SamplingSource, Ticks, Tsc, offset,
};

use crate::memory::{Queue, Region};

const MAXIMUM: u32 = 20;

/// Sends "1" and "2" through a queue of depth 2, spoils a word of the region, and returns what the
/// next three calls of the destination bring. The lie must have been counted once.
fn spoilt(policy: Policy, at: usize, value: u64) -> [Result<Vec<u8>, ReceiveError>; 3] {
    let queue = Queue::new(MAXIMUM, 2, policy);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    source.send(b"1", Tsc(0)).unwrap();
    source.send(b"2", Tsc(0)).unwrap();
    queue.messages.poke(at, value);
    let results = [(); 3].map(|()| {
        let mut buffer = [0; MAXIMUM as usize];
        destination.receive(&mut buffer).map(|received| received.bytes.to_vec())
    });
    assert_eq!(destination.status().counters.hostile, 1, "{policy:?} {at} {value:#x}");
    // Whatever it was, an honest source goes on from here, if not with its first message.
    let going_on = (0..4).any(|_| {
        let sent = source.send(b"3", Tsc(0)).is_ok();
        let mut buffer = [0; MAXIMUM as usize];
        let received = destination.receive(&mut buffer).is_ok_and(|r| r.bytes == b"3");
        sent && received
    });
    assert!(going_on, "{policy:?} {at} {value:#x}");
    results
}

fn hostile(claim: Claim) -> Result<Vec<u8>, ReceiveError> {
    Err(ReceiveError::Hostile(claim))
}

#[test]
fn a_message_with_an_impossible_length_is_skipped() {
    for policy in [Policy::Refuse, Policy::Overwrite] {
        for length in [0, u64::from(MAXIMUM) + 1, 1 << 32, u64::MAX] {
            let [one, two, three] = spoilt(policy, offset::SLOT + offset::LENGTH, length);
            assert_eq!(one, hostile(Claim::Length));
            assert_eq!((two, three), (Ok(b"2".to_vec()), Err(ReceiveError::Empty)));
        }
    }
}

#[test]
fn a_message_with_an_impossible_sequence_is_skipped() {
    // The first message is complete with 2: 0 and 1 are too old, the others from the future.
    for policy in [Policy::Refuse, Policy::Overwrite] {
        for sequence in [0, 1, 3, 1000, 1 << 63, u64::MAX] {
            let [one, two, three] = spoilt(policy, offset::SLOT + offset::SEQUENCE, sequence);
            assert_eq!(one, hostile(Claim::Sequence), "{sequence}");
            assert_eq!((two, three), (Ok(b"2".to_vec()), Err(ReceiveError::Empty)));
        }
    }
}

#[test]
fn a_counter_that_goes_back_leaves_nothing_waiting() {
    let queue = Queue::new(MAXIMUM, 2, Policy::Refuse);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    let mut buffer = [0; MAXIMUM as usize];
    source.send(b"1", Tsc(0)).unwrap();
    destination.receive(&mut buffer).unwrap();
    queue.messages.poke(offset::WRITTEN, 0);
    let error = destination.receive(&mut buffer).unwrap_err();
    assert_eq!(error, ReceiveError::Hostile(Claim::Counter));
    assert_eq!(error.code(), ReturnCode::NotAvailable);
    assert_eq!(destination.receive(&mut buffer), Err(ReceiveError::Empty));
}

#[test]
fn more_than_the_depth_is_a_lie_only_where_the_source_must_refuse() {
    let [one, two, _] = spoilt(Policy::Refuse, offset::WRITTEN, 3);
    assert_eq!((one, two), (hostile(Claim::Counter), Err(ReceiveError::Empty)));
    let [one, two, _] = spoilt(Policy::Overwrite, offset::WRITTEN, 3);
    // Three written, one of them lost; the third is the lie.
    assert_eq!((one, two), (Ok(b"2".to_vec()), hostile(Claim::Sequence)));
}

#[test]
fn a_first_message_that_is_ahead_of_the_counter_is_a_lie_at_every_look() {
    for policy in [Policy::Refuse, Policy::Overwrite] {
        let queue = Queue::new(MAXIMUM, 2, policy);
        let (mut source, mut destination) = (queue.source(), queue.destination());
        source.send(b"1", Tsc(0)).unwrap();
        queue.messages.poke(offset::FIRST, 2);
        let mut buffer = [0; MAXIMUM as usize];
        for lies in 1..4 {
            assert_eq!(
                destination.receive(&mut buffer).unwrap_err().code(),
                ReturnCode::NotAvailable
            );
            assert_eq!(destination.status().counters.hostile, 2 * lies, "one for the status");
        }
        queue.messages.poke(offset::FIRST, 0);
        source.send(b"2", Tsc(0)).unwrap();
        assert_eq!(destination.receive(&mut buffer).unwrap().bytes, b"2");
    }
}

#[test]
fn a_destination_that_says_what_cannot_be_is_counted_and_not_believed() {
    let queue = Queue::new(MAXIMUM, 2, Policy::Refuse);
    let (mut source, _destination) = (queue.source(), queue.destination());
    source.send(b"1", Tsc(0)).unwrap();
    for (lies, read) in [2, 1 << 62, 1 << 63].into_iter().enumerate() {
        queue.acknowledgement.poke(offset::READ, read);
        let status = source.status();
        assert_eq!((status.waiting, status.counters.hostile), (1, 1 + lies as u64), "{read}");
    }
    queue.acknowledgement.poke(offset::READ, 1);
    assert_eq!(source.status().waiting, 0);
    queue.acknowledgement.poke(offset::READ, 0);
    let status = source.status();
    assert_eq!((status.waiting, status.counters.hostile), (0, 4), "taken back");
}

#[test]
fn impossible_samples_are_not_delivered() {
    for (at, value, claim) in [
        (offset::FIRST, 2, Claim::Counter),
        (offset::WRITTEN, 1 << 62, Claim::Counter),
        (offset::WRITTEN, 2, Claim::Sequence),
        (offset::SLOT + offset::SEQUENCE, 0, Claim::Sequence),
        (offset::SLOT + offset::LENGTH, 0, Claim::Length),
        (offset::SLOT + offset::LENGTH, 21, Claim::Length),
    ] {
        let geometry = Geometry::sampling(MAXIMUM).unwrap();
        let region = Region::source(&geometry);
        let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
        let mut destination =
            SamplingDestination::open(region.clone(), &geometry, Ticks(1)).unwrap();
        source.write(b"1", Tsc(0)).unwrap();
        let honest = region.peek(at);
        region.poke(at, value);
        let mut buffer = [0; MAXIMUM as usize];
        let error = destination.read(&mut buffer, Tsc(0)).unwrap_err();
        assert_eq!(error, ReadError::Hostile(claim), "{at}");
        assert_eq!(error.code(), ReturnCode::NotAvailable);
        assert_eq!(destination.status().counters.hostile, 1);
        region.poke(at, honest);
        assert_eq!(destination.read(&mut buffer, Tsc(0)).unwrap().bytes, b"1");
    }
}
