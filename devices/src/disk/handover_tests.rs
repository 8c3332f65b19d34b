//! Queues handed over, taken, returned and taken away, by two threads.

use virtio_bindings::virtio_mmio::{VIRTIO_MMIO_INTERRUPT_STATUS, VIRTIO_MMIO_STATUS};
use virtio_queue::QueueT;

use super::*;
use crate::virtio::driver::page;

fn queue() -> Queue {
    Queue::new(8).unwrap()
}

#[test]
fn a_queue_is_taken_once_and_given_back() {
    let handover = Handover::new(page());
    assert!(handover.take().is_none());
    handover.enable(queue());
    let (taken, lease) = handover.take().unwrap();
    assert!(handover.take().is_none());
    assert_eq!(handover.touch(&lease, || 7), Ok(7));
    assert!(!handover.give_back(&lease, Some((taken, false))));
    let (taken, lease) = handover.take().unwrap();
    assert!(handover.give_back(&lease, Some((taken, true))));
}

#[test]
fn a_recall_ends_the_lease_at_once_and_what_comes_back_late_is_nothing() {
    let handover = Handover::new(page());
    handover.enable(queue());
    let (late, lease) = handover.take().unwrap();
    // The server is still busy with it.
    handover.recall();
    assert_eq!(handover.touch(&lease, || panic!("the guest's memory is touched")), Err(Recalled));
    assert!(handover.take().is_none());
    // The guest has another queue by the time that the server is done with the first.
    handover.enable(queue());
    assert!(!handover.give_back(&lease, Some((late, true))), "the guest is interrupted");
    let (_, lease) = handover.take().unwrap();
    assert_eq!(handover.touch(&lease, || 7), Ok(7));
}

#[test]
fn a_queue_that_was_broken_before_a_reset_does_not_break_the_next() {
    let handover = Handover::new(page());
    handover.enable(queue());
    let (_, lease) = handover.take().unwrap();
    handover.recall();
    handover.enable(queue());
    assert!(!handover.give_back(&lease, None));
    assert_eq!(handover.page.get(VIRTIO_MMIO_STATUS), 0);
    assert!(handover.take().is_some());
}

#[test]
fn a_broken_queue_is_gone_and_the_guest_is_told() {
    let handover = Handover::new(page());
    handover.enable(queue());
    let (_, lease) = handover.take().unwrap();
    assert!(handover.give_back(&lease, None));
    // "Needs reset", and an interrupt for a change of the configuration.
    let told = [VIRTIO_MMIO_STATUS, VIRTIO_MMIO_INTERRUPT_STATUS].map(|at| handover.page.get(at));
    assert_eq!(told, [0x40, 2]);
    assert!(handover.take().is_none());
}
