//! Queues handed over, taken, returned and taken away, by two threads.

use virtio_queue::QueueT;

use super::*;

fn queue() -> Queue {
    Queue::new(8).unwrap()
}

#[test]
fn a_queue_is_taken_once_and_given_back() {
    let handover = Handover::default();
    assert!(handover.take().is_none());
    handover.enable(queue());
    let (taken, lease) = handover.take().unwrap();
    assert!(handover.take().is_none());
    assert_eq!(handover.touch(&lease, || 7), Ok(7));
    assert!(!handover.give_back(&lease, Some((taken, false))));
    assert_eq!(handover.interrupts(), 0);
    let (taken, lease) = handover.take().unwrap();
    assert!(handover.give_back(&lease, Some((taken, true))));
    assert_eq!(handover.interrupts(), VIRTIO_MMIO_INT_VRING);
    handover.acknowledge(VIRTIO_MMIO_INT_VRING);
    assert_eq!(handover.interrupts(), 0);
}

#[test]
fn a_recall_ends_the_lease_at_once_and_what_comes_back_late_is_nothing() {
    for end in [Handover::reset, Handover::recall] {
        let handover = Handover::default();
        handover.enable(queue());
        let (late, lease) = handover.take().unwrap();
        // The server is still busy with it.
        end(&handover);
        assert_eq!(
            handover.touch(&lease, || panic!("the guest's memory is touched")),
            Err(Recalled)
        );
        assert!(handover.take().is_none());
        // The guest has another queue by the time that the server is done with the first.
        handover.enable(queue());
        assert!(!handover.give_back(&lease, Some((late, true))), "the guest is interrupted");
        assert_eq!(handover.interrupts(), 0);
        let (_, lease) = handover.take().unwrap();
        assert_eq!(handover.touch(&lease, || 7), Ok(7));
    }
}

#[test]
fn a_queue_that_was_broken_before_a_reset_does_not_break_the_next() {
    let handover = Handover::default();
    handover.enable(queue());
    let (_, lease) = handover.take().unwrap();
    handover.reset();
    handover.enable(queue());
    assert!(!handover.give_back(&lease, None));
    assert!(!handover.needs_reset());
    assert!(handover.take().is_some());
}

#[test]
fn a_broken_queue_is_gone_and_the_guest_is_told() {
    let handover = Handover::default();
    handover.enable(queue());
    let (_, lease) = handover.take().unwrap();
    assert!(handover.give_back(&lease, None));
    assert!(handover.needs_reset());
    assert_eq!(handover.interrupts(), VIRTIO_MMIO_INT_CONFIG);
    assert!(handover.take().is_none());
    handover.reset();
    assert!(!handover.needs_reset());
}
