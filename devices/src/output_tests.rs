//! A reader that is slow, or gone, and a writer that must not wait for it.

use std::io::Write;
use std::thread;

use super::*;

#[test]
fn a_flood_is_dropped_and_counted_to_the_byte() {
    let (mut guest, mut end) = dropping();
    let flood = vec![b'x'; CAPACITY];
    guest.write(&flood);
    guest.write(b"lost");
    let mut seen = Vec::new();
    end.drain_into(&mut seen);
    assert_eq!((seen, end.dropped()), (flood, 4));
    guest.write(b"back");
    let mut seen = Vec::new();
    end.drain_into(&mut seen);
    assert_eq!(seen, b"back");
}

#[test]
fn no_more_is_taken_than_is_allowed_and_the_rest_stays() {
    let (mut guest, mut end) = dropping();
    guest.write(b"one\ntwo\nthree");
    let mut take = |bytes, lines| {
        let mut seen = Vec::new();
        end.take_into(&mut seen, Allowance { bytes, lines });
        String::from_utf8(seen).unwrap()
    };
    assert_eq!((take(0, 9), take(9, 0)), (String::new(), String::new()));
    assert_eq!(take(2, 9), "on");
    assert_eq!(take(99, 1), "e\n");
    assert_eq!(take(6, 2), "two\nth");
    assert_eq!(take(99, 1), "ree");
    assert_eq!(take(99, 1), "");
}

#[test]
fn a_waiting_writer_loses_nothing() {
    let stop = Arc::new(AtomicBool::new(false));
    let (mut guest, mut end) = waiting(stop);
    let sent: Vec<u8> = (0..3 * CAPACITY).map(|n| n as u8).collect();
    let copy = sent.clone();
    let writer = thread::spawn(move || {
        let mut left = &copy[..];
        while !left.is_empty() {
            match guest.would_wait(1) {
                true => thread::yield_now(),
                false => left = &left[guest.write(left).unwrap()..],
            }
        }
    });
    let mut seen = Vec::new();
    while seen.len() < sent.len() {
        end.drain_into(&mut seen);
        thread::yield_now();
    }
    writer.join().unwrap();
    assert_eq!(seen, sent);
}

#[test]
fn a_write_for_which_there_is_no_room_does_not_wait_by_itself() {
    let (mut guest, _end) = waiting(Arc::new(AtomicBool::new(false)));
    assert_eq!(guest.write(&vec![0; CAPACITY + 1]).unwrap(), CAPACITY);
    assert!(guest.would_wait(1));
    assert_eq!(guest.write(&[0]).unwrap_err().kind(), io::ErrorKind::WouldBlock);
}

#[test]
fn a_waiting_writer_gives_up_when_told_to_stop() {
    let stop = Arc::new(AtomicBool::new(true));
    let (mut guest, _end) = waiting(stop);
    assert!(guest.write_all(&vec![0; CAPACITY + 1]).is_err());
}
