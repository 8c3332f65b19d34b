//! What honest clients get, and what becomes of what they send.

use std::cell::{Cell, RefCell};

use super::*;

#[test]
fn every_client_gets_each_sample_once_with_its_age_and_a_late_one_gets_the_newest() {
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.sampling_source();
    let [one, two] = [0, 1].map(|_| connect(&bench.path()).unwrap());
    bench.tick(&mut ports);
    assert_eq!(packet(&one), None);

    let stamp = bench.stamp();
    guest.write(b"first", stamp).unwrap();
    bench.now += 999;
    bench.tick(&mut ports);
    let header = Header { taken_ns: 1_001_000, age_ns: 1_000_000, flags: VALID, length: 5 };
    assert_eq!(packet(&one), Some((header, b"first".to_vec())));
    assert_eq!(packet(&two), Some((header, b"first".to_vec())));
    bench.tick(&mut ports);
    assert_eq!((packet(&one), packet(&two)), (None, None));

    // Later than the refresh period, and without waiting for a tick.
    bench.now += 10_000;
    let late = connect(&bench.path()).unwrap();
    bench.ready(&mut ports);
    let (header, bytes) = packet(&late).unwrap();
    assert_eq!((header.flags, header.age_ns, &bytes[..]), (0, 11_001_000, &b"first"[..]));
    assert_eq!(packet(&one), None);
    assert_eq!(account(&mut ports).messages, 3);
}

#[test]
fn a_client_that_does_not_read_misses_samples_and_no_other_does() {
    let mut bench = Bench::new(SAMPLING, 60_000, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.sampling_source();
    let [slow, quick] = [0, 1].map(|_| connect(&bench.path()).unwrap());
    let mut sample = vec![0; 60_000];
    for n in 0..100u32 {
        sample[..4].copy_from_slice(&number(n));
        guest.write(&sample, bench.stamp()).unwrap();
        bench.tick(&mut ports);
        assert_eq!(message(&quick).unwrap()[..4], number(n));
    }
    // What fits the kernel's buffer is old; the next is the newest.
    let old = std::iter::from_fn(|| message(&slow)).count();
    assert!((1..50).contains(&old), "{old}");
    bench.tick(&mut ports);
    assert_eq!(message(&slow).unwrap()[..4], number(99));
    assert_eq!(message(&slow), None);
}

#[test]
fn a_queue_waits_for_a_client_and_then_comes_once_and_in_order() {
    let mut bench = Bench::new(queuing(3, WhenFull::Refuse), MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.queuing_source();
    for n in 0..3 {
        guest.send(&number(n), bench.stamp()).unwrap();
    }
    bench.tick(&mut ports);
    assert!(guest.send(&number(3), bench.stamp()).is_err(), "taken without a client");

    let client = connect(&bench.path()).unwrap();
    bench.tick(&mut ports);
    let second = connect(&bench.path()).unwrap();
    bench.ready(&mut ports);
    let all: Vec<_> = std::iter::from_fn(|| message(&client)).collect();
    assert_eq!(all, [0, 1, 2].map(number));
    assert!(second.is_closed(), "a second client beside the first");
    assert_eq!((account(&mut ports).messages, account(&mut ports).refused), (3, 1));

    drop(client);
    guest.send(&number(3), bench.stamp()).unwrap();
    let next = connect(&bench.path()).unwrap();
    bench.tick(&mut ports);
    assert_eq!(message(&next), Some(number(3).to_vec()));
}

#[test]
fn a_message_that_a_client_had_no_room_for_is_the_next_ones() {
    let mut bench = Bench::new(queuing(8, WhenFull::Refuse), 60_000, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.queuing_source();
    let client = connect(&bench.path()).unwrap();
    let mut bytes = vec![0; 60_000];
    for n in 0..8 {
        bytes[..4].copy_from_slice(&number(n));
        guest.send(&bytes, bench.stamp()).unwrap();
    }
    (0..8).for_each(|_| bench.tick(&mut ports));
    let sent = account(&mut ports).messages as u32;
    assert!((1..8).contains(&sent), "{sent}");
    drop(client);
    let mut all = Vec::new();
    let next = connect(&bench.path()).unwrap();
    for _ in 0..8 {
        bench.tick(&mut ports);
        all.extend(std::iter::from_fn(|| message(&next)));
    }
    let first: Vec<[u8; 4]> = all.iter().map(|m| m[..4].try_into().unwrap()).collect();
    assert_eq!(first, (sent..8).map(number).collect::<Vec<_>>());
}

#[test]
fn a_queue_that_overwrites_says_that_messages_are_lost() {
    let mut bench = Bench::new(queuing(2, WhenFull::Overwrite), MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.queuing_source();
    for n in 0..5 {
        guest.send(&number(n), bench.stamp()).unwrap();
    }
    let client = connect(&bench.path()).unwrap();
    bench.tick(&mut ports);
    let (header, bytes) = packet(&client).unwrap();
    assert_eq!((header.flags, &bytes[..]), (LOST, &number(3)[..]));
    assert_eq!(packet(&client).unwrap().0.flags, 0);
    assert_eq!(account(&mut ports).lost, 3);
}

#[test]
fn nothing_that_a_client_sends_is_lost_when_the_queue_is_full() {
    let mut bench = Bench::new(queuing(4, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let client = connect(&bench.path()).unwrap();
    let sent = flood(&client, 0);
    assert!(sent > 10, "{sent}");
    // Before the guest has opened its port, anything would be void.
    bench.tick(&mut ports);
    assert_eq!(account(&mut ports).messages, 0);
    let mut guest = bench.queuing_destination();
    // What was sent is heard of although its sender has gone.
    drop(client);
    let mut all = Vec::new();
    while all.len() < sent as usize {
        let before = all.len();
        bench.tick(&mut ports);
        all.extend(received(&mut guest));
        assert!((1..=4).contains(&(all.len() - before)), "{}", all.len() - before);
    }
    assert_eq!(all, (0..sent).collect::<Vec<_>>());
    assert_eq!(account(&mut ports).messages, u64::from(sent));
}

#[test]
fn clients_take_turns() {
    let mut bench = Bench::new(queuing(4, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let mut guest = bench.queuing_destination();
    let [one, two] = [0, 1].map(|_| connect(&bench.path()).unwrap());
    flood(&one, 1_000);
    flood(&two, 2_000);
    bench.tick(&mut ports);
    assert_eq!(received(&mut guest), [1_000, 2_000, 1_001, 2_001]);
}

#[test]
fn a_sampling_guest_reads_what_a_client_wrote_last() {
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let region = Peer::map(&bench.regions().source).unwrap();
    let geometry = &bench.regions().geometry;
    let mut guest = SamplingDestination::open(region, geometry, Ticks(100)).unwrap();
    let client = connect(&bench.path()).unwrap();
    assert_eq!((client.send(b"old"), client.send(b"new")), (Sent::Yes, Sent::Yes));
    // What no message can be is left behind, and does not become one.
    let wrong = connect(&bench.path()).unwrap();
    assert_eq!(wrong.send(&[b'?'; MAXIMUM as usize + 1]), Sent::Yes);
    bench.tick(&mut ports);
    let mut buffer = [0; MAXIMUM as usize];
    assert_eq!(guest.read(&mut buffer, bench.stamp()).unwrap().bytes, b"new");
    // What had become old in the socket was never there as fresh.
    assert_eq!(account(&mut ports).messages, 1);
    let written = Peer::map(&bench.regions().source).unwrap().load(offset::WRITTEN / 8);
    assert_eq!(written, 1);
    bench.tick(&mut ports);
    assert_eq!(account(&mut ports).messages, 1, "sent again");
}

#[test]
fn a_client_wakes_the_event_thread_once() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let is_ready = |ports: &HostPorts| {
        let mut poll = libc::pollfd { fd: ports.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: one live structure; a time-out of 0 does not wait.
        unsafe { libc::poll(&raw mut poll, 1, 0) == 1 }
    };
    assert!(!is_ready(&ports));
    let _client = connect(&bench.path()).unwrap();
    assert!(is_ready(&ports));
    bench.ready(&mut ports);
    assert!(!is_ready(&ports));
}

#[test]
fn a_sample_that_comes_during_a_look_is_from_no_future() {
    let bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let guest = RefCell::new(bench.sampling_source());
    let client = connect(&bench.path()).unwrap();
    guest.borrow_mut().write(b"before", bench.stamp()).unwrap();
    // By the time at which the clock is read, the thread was put off for longer than the refresh period.
    let came = Cell::new(false);
    let late = || {
        if !came.replace(true) {
            guest.borrow_mut().write(b"after", takt_channel::Tsc(EPOCH.0 + 9_000)).unwrap();
            return EPOCH;
        }
        Tsc(EPOCH.0 + 9_000)
    };
    ports.on_tick(&bench.clock, &late);
    let header = Header { taken_ns: 9_000_000, age_ns: 0, flags: VALID, length: 5 };
    assert_eq!(packet(&client), Some((header, b"after".to_vec())));
    assert_eq!(account(&mut ports).hostile, 0);
}

#[test]
fn no_two_messages_have_the_same_stamp() {
    for kind in [SAMPLING, queuing(8, WhenFull::Refuse)] {
        let bench = Bench::new(kind, MAXIMUM, HostPort::Socket, true);
        let mut end = Source::open(bench.regions()).unwrap();
        let mut queue = (kind != SAMPLING).then(|| bench.queuing_destination());
        let region = || Peer::map(&bench.regions().source).unwrap();
        let geometry = &bench.regions().geometry;
        let mut sample = (kind == SAMPLING)
            .then(|| SamplingDestination::open(region(), geometry, Ticks(100)).unwrap());
        let mut buffer = [0; MAXIMUM as usize];
        let mut stamps = Vec::new();
        // The clock stands still, and then goes on.
        for at in [5, 5, 5, 6, 20] {
            assert!(end.send(b"x", &|| Tsc(at)));
            stamps.extend(queue.as_mut().map(|queue| queue.receive(&mut buffer).unwrap().stamp.0));
            let now = takt_channel::Tsc(at);
            stamps.extend(sample.as_mut().map(|port| port.read(&mut buffer, now).unwrap().stamp.0));
        }
        assert_eq!(stamps, [5, 6, 7, 8, 20]);
    }
}
