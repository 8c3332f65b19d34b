//! Random histories against a reference that is too simple to be wrong.

use std::collections::VecDeque;

use proptest::prelude::*;
use takt_channel::{
    Geometry, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, SendError, Ticks, Tsc, Validity,
};

use crate::memory::{Queue, Region, whole};

#[derive(Clone, Debug)]
enum Step {
    Send,
    Receive,
    Clear,
    RestartSource,
    RestartDestination,
    FollowSource,
    FollowDestination,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        12 => Just(Step::Send),
        8 => Just(Step::Receive),
        1 => Just(Step::Clear),
        1 => Just(Step::RestartSource),
        1 => Just(Step::RestartDestination),
        3 => Just(Step::FollowSource),
        3 => Just(Step::FollowDestination),
    ];
    prop::collection::vec(step, 0..200)
}

/// A queue as a list.
#[derive(Default)]
struct Reference {
    waiting: VecDeque<u64>,
    overflowed: bool,
    /// Lost and not yet noticed by the destination, which is told by its next look.
    lost: u64,
}

impl Reference {
    fn send(&mut self, n: u64, depth: usize, policy: Policy) -> Result<(), SendError> {
        if self.waiting.len() == depth {
            if policy == Policy::Refuse {
                return Err(SendError::Full);
            }
            self.waiting.pop_front();
            self.overflowed = true;
            self.lost += 1;
        }
        self.waiting.push_back(n);
        Ok(())
    }

    fn empty(&mut self) {
        *self = Reference::default();
    }
}

fn run_queue(maximum: usize, depth: u32, policy: Policy, steps: &[Step]) {
    let queue = Queue::new(maximum as u32, depth, policy);
    let mut source: QueuingSource<_, _> = queue.source();
    let mut destination: QueuingDestination<_, _> = queue.destination();
    let mut reference = Reference::default();
    let mut lost = 0;
    let mut n = 0;
    for step in steps {
        match step {
            Step::Send => {
                n += 1;
                let sent = source.send(&whole(n, maximum), Tsc(n));
                assert_eq!(sent, reference.send(n, depth as usize, policy));
            }
            Step::Receive => {
                let mut buffer = vec![0; maximum];
                let received = destination.receive(&mut buffer);
                lost += std::mem::take(&mut reference.lost);
                match reference.waiting.pop_front() {
                    None => assert_eq!(received, Err(ReceiveError::Empty)),
                    Some(n) => {
                        let received = received.unwrap();
                        assert_eq!(received.bytes, whole(n, maximum));
                        assert_eq!(received.stamp, Tsc(n));
                        let told = std::mem::take(&mut reference.overflowed);
                        assert_eq!(received.overflowed, told);
                    }
                }
            }
            Step::Clear => {
                destination.clear();
                lost += reference.lost;
                reference.empty();
            }
            Step::RestartSource => {
                // What is lost here and was not noticed yet is void rather than overwritten; an
                // overflow that was noticed is still told.
                destination.status();
                lost += reference.lost;
                let overflowed = reference.overflowed;
                source = queue.source();
                reference.empty();
                reference.overflowed = overflowed;
            }
            Step::RestartDestination => {
                destination = queue.destination();
                reference.empty();
                lost = 0;
            }
            Step::FollowSource => {
                let (own, peer) = (queue.messages.clone(), queue.acknowledgement.clone());
                source = QueuingSource::attach(own, peer, &queue.geometry).unwrap();
            }
            Step::FollowDestination => {
                let (peer, own) = (queue.messages.clone(), queue.acknowledgement.clone());
                destination = QueuingDestination::attach(peer, own, &queue.geometry).unwrap();
                // What the one before has noticed, it cannot tell any more.
                reference.overflowed = reference.lost > 0;
                lost = 0;
            }
        }
        assert_eq!(source.status().waiting as usize, reference.waiting.len());
    }
    let status = destination.status();
    assert_eq!(status.waiting as usize, reference.waiting.len());
    assert_eq!(status.counters.lost, lost + reference.lost);
    assert_eq!(status.counters.hostile + status.counters.unstable, 0);
    assert_eq!(source.status().counters.hostile, 0);
}

#[derive(Clone, Debug)]
enum SamplingStep {
    Write,
    Read { destination: usize },
    Wait(u64),
    RestartSource,
    RestartDestination(usize),
    FollowSource,
    FollowDestination(usize),
}

fn sampling_steps() -> impl Strategy<Value = Vec<SamplingStep>> {
    let step = prop_oneof![
        6 => Just(SamplingStep::Write),
        8 => (0..2_usize).prop_map(|destination| SamplingStep::Read { destination }),
        4 => (0..100_u64).prop_map(SamplingStep::Wait),
        1 => Just(SamplingStep::RestartSource),
        1 => (0..2_usize).prop_map(SamplingStep::RestartDestination),
        2 => Just(SamplingStep::FollowSource),
        1 => (0..2_usize).prop_map(SamplingStep::FollowDestination),
    ];
    prop::collection::vec(step, 0..200)
}

fn run_sampling(maximum: usize, refresh: u64, steps: &[SamplingStep]) {
    let geometry = Geometry::sampling(maximum as u32).unwrap();
    let region = Region::source(&geometry);
    let source = || SamplingSource::open(region.clone(), &geometry).unwrap();
    let destination =
        || SamplingDestination::open(region.clone(), &geometry, Ticks(refresh)).unwrap();
    let mut writer = source();
    let mut readers = [destination(), destination()];
    // The message that each destination must see.
    let mut newest: [Option<u64>; 2] = [None; 2];
    let mut in_this_life = None;
    let mut now = 0;
    for step in steps {
        match *step {
            SamplingStep::Write => {
                now += 1;
                writer.write(&whole(now, maximum), Tsc(now)).unwrap();
                in_this_life = Some(now);
                newest = [in_this_life; 2];
            }
            SamplingStep::Read { destination } => {
                let mut buffer = vec![0; maximum];
                let sample = readers[destination].read(&mut buffer, Tsc(now));
                let Some(n) = newest[destination] else {
                    assert_eq!(sample, Err(ReadError::NeverWritten));
                    continue;
                };
                let sample = sample.unwrap();
                assert_eq!((sample.bytes, sample.stamp), (&whole(n, maximum)[..], Tsc(n)));
                assert_eq!(sample.age, Ticks(now - n));
                assert_eq!(sample.validity == Validity::Valid, now - n <= refresh);
                assert_eq!(readers[destination].status().validity, sample.validity);
            }
            SamplingStep::Wait(ticks) => now += ticks,
            SamplingStep::RestartSource => {
                writer = source();
                in_this_life = None;
                newest = [in_this_life; 2];
            }
            SamplingStep::RestartDestination(i) => {
                readers[i] = destination();
                newest[i] = None;
            }
            SamplingStep::FollowSource => {
                writer = SamplingSource::attach(region.clone(), &geometry).unwrap();
            }
            SamplingStep::FollowDestination(i) => {
                readers[i] =
                    SamplingDestination::attach(region.clone(), &geometry, Ticks(refresh)).unwrap();
                newest[i] = in_this_life;
            }
        }
    }
    for reader in readers {
        assert_eq!(reader.status().counters.hostile + reader.status().counters.unstable, 0);
    }
}

proptest! {
    #[test]
    fn a_queue_that_refuses_is_a_list(
        maximum in 1..40_usize, depth in 1..6_u32, steps in steps(),
    ) {
        run_queue(maximum, depth, Policy::Refuse, &steps);
    }

    #[test]
    fn a_queue_that_overwrites_is_a_list_that_drops_its_head(
        maximum in 1..40_usize, depth in 1..6_u32, steps in steps(),
    ) {
        run_queue(maximum, depth, Policy::Overwrite, &steps);
    }

    #[test]
    fn a_sampling_channel_is_a_variable_with_a_time(
        maximum in 1..40_usize, refresh in 1..150_u64, steps in sampling_steps(),
    ) {
        run_sampling(maximum, refresh, &steps);
    }
}
