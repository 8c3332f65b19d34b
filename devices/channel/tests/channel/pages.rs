//! Real pages, mapped twice, with the directions that the MMU enforces, and real threads.

use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use takt_channel::{
    Geometry, Load, Misaligned, OwnPages, PeerPages, Policy, QueuingDestination, QueuingSource,
    ReceiveError, SamplingDestination, SamplingSource, SendError, Ticks, Tsc,
};

use crate::memory::{number_of, whole};

const BYTES: usize = 4096;

/// One page of shared memory: as its owner sees it, and as its peer does.
fn shared_page() -> (NonNull<u8>, NonNull<u8>) {
    // SAFETY: the name is a literal C string.
    let fd = unsafe { libc::memfd_create(c"channel-test".as_ptr(), libc::MFD_CLOEXEC) };
    assert!(fd >= 0);
    // SAFETY: plain integers.
    assert_eq!(unsafe { libc::ftruncate(fd, BYTES as libc::off_t) }, 0);
    let map = |protection| {
        // SAFETY: a new mapping at an address of the kernel's choice; never unmapped, so that it
        // is valid for ever.
        let at = unsafe { libc::mmap(ptr::null_mut(), BYTES, protection, libc::MAP_SHARED, fd, 0) };
        assert_ne!(at, libc::MAP_FAILED);
        NonNull::new(at.cast()).unwrap()
    };
    let pages = (map(libc::PROT_READ | libc::PROT_WRITE), map(libc::PROT_READ));
    // SAFETY: this function's own descriptor, not used again.
    unsafe { libc::close(fd) };
    pages
}

fn own(start: NonNull<u8>) -> OwnPages<'static> {
    // SAFETY: from `shared_page`: mapped for ever, writable, and accessed as a channel only.
    unsafe { OwnPages::new(start, BYTES) }.unwrap()
}

fn peer(start: NonNull<u8>) -> PeerPages<'static> {
    // SAFETY: as in `own`, read-only.
    unsafe { PeerPages::new(start, BYTES) }.unwrap()
}

const MAXIMUM: usize = 100;

/// Ends the other thread, also when an assertion ends this one.
struct Stop<'a>(&'a AtomicBool);

impl Drop for Stop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn samples_are_whole_across_a_read_only_mapping() {
    let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
    let (mine, theirs) = shared_page();
    geometry.format_source(&mut own(mine)).unwrap();
    let mut source = SamplingSource::open(own(mine), &geometry).unwrap();
    let mut destination =
        SamplingDestination::open(peer(theirs), &geometry, Ticks(u64::MAX)).unwrap();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut n = 0;
            while !stop.load(Ordering::Relaxed) {
                n += 1;
                source.write(&whole(n, MAXIMUM), Tsc(n)).unwrap();
            }
        });
        let _stop = Stop(&stop);
        let (mut last, mut read) = (0, 0);
        while read < 10_000 {
            let mut buffer = [0; MAXIMUM];
            if let Ok(sample) = destination.read(&mut buffer, Tsc(0)) {
                let n = number_of(sample.bytes, sample.stamp, MAXIMUM);
                assert!(n >= last);
                (last, read) = (n, read + 1);
            }
        }
    });
    assert_eq!(destination.status().counters.hostile, 0);
}

#[test]
fn a_queue_delivers_all_in_order_across_read_only_mappings() {
    let geometry = Geometry::queuing(MAXIMUM as u32, 4, Policy::Refuse).unwrap();
    let (messages, messages_seen) = shared_page();
    let (taken, taken_seen) = shared_page();
    geometry.format_source(&mut own(messages)).unwrap();
    geometry.format_destination(&mut own(taken)).unwrap();
    let mut source = QueuingSource::open(own(messages), peer(taken_seen), &geometry).unwrap();
    let mut destination =
        QueuingDestination::open(peer(messages_seen), own(taken), &geometry).unwrap();
    const COUNT: u64 = 10_000;
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            for n in 0..COUNT {
                while source.send(&whole(n, MAXIMUM), Tsc(n)) == Err(SendError::Full)
                    && !stop.load(Ordering::Relaxed)
                {
                    thread::yield_now();
                }
            }
            assert_eq!(source.status().counters.hostile, 0);
        });
        let _stop = Stop(&stop);
        let mut expected = 0;
        while expected < COUNT {
            let mut buffer = [0; MAXIMUM];
            match destination.receive(&mut buffer) {
                Ok(message) => {
                    assert_eq!(number_of(message.bytes, message.stamp, MAXIMUM), expected);
                    assert!(!message.overflowed);
                    expected += 1;
                }
                Err(error) => {
                    assert_eq!(error, ReceiveError::Empty);
                    thread::yield_now();
                }
            }
        }
    });
    assert_eq!(destination.status().counters.hostile, 0);
}

#[test]
fn memory_that_is_not_aligned_is_refused() {
    let (mine, theirs) = shared_page();
    // SAFETY: inside the page.
    let (mine, theirs) = unsafe { (mine.add(4), theirs.add(4)) };
    // SAFETY: as in `own`, four bytes less.
    assert_eq!(unsafe { OwnPages::new(mine, BYTES - 4) }.err(), Some(Misaligned));
    // SAFETY: as in `peer`, four bytes less.
    assert_eq!(unsafe { PeerPages::new(theirs, BYTES - 4) }.err(), Some(Misaligned));
}

#[test]
fn words_outside_the_pages_are_zero() {
    let (_, theirs) = shared_page();
    let pages = peer(theirs);
    assert_eq!((pages.words(), pages.load(512), pages.load(usize::MAX)), (512, 0, 0));
}
