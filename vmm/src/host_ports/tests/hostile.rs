//! Clients and guests that do what they should not: they cost only their own messages.

use super::*;

#[test]
fn a_packet_that_is_no_message_ends_the_connection_and_no_other() {
    let mut bench = Bench::new(queuing(4, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let mut guest = bench.queuing_destination();
    let [good, empty, long, huge] = [0; 4].map(|_| connect(&bench.path()).unwrap());
    assert_eq!(empty.send(&[]), Sent::Yes);
    assert_eq!(long.send(&[0; MAXIMUM as usize + 1]), Sent::Yes);
    assert_eq!(huge.send(&vec![0; 150_000]), Sent::Yes);
    assert_eq!(good.send(&number(7)), Sent::Yes);
    bench.tick(&mut ports);
    assert!(empty.is_closed() && long.is_closed() && huge.is_closed() && !good.is_closed());
    assert_eq!(account(&mut ports).dropped, 3);
    assert_eq!(received(&mut guest), [7]);
    // Going is no offence.
    drop(good);
    bench.tick(&mut ports);
    assert_eq!(account(&mut ports).dropped, 3);
}

#[test]
fn a_flood_costs_no_more_than_a_tick_may_cost() {
    let mut bench = Bench::new(queuing(4, WhenFull::Overwrite), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let _guest = bench.queuing_destination();
    let clients = [0; 8].map(|_| connect(&bench.path()).unwrap());
    for tick in 1..=3 {
        bench.tick(&mut ports);
        for _ in 0..10 {
            for client in &clients {
                flood(client, 0);
            }
            bench.ready(&mut ports);
        }
        let messages = account(&mut ports).messages;
        // Of the first tick, 8 went into the connections.
        assert_eq!(messages, tick * 64 - 8);
    }
}

#[test]
fn a_client_that_is_not_served_for_now_wakes_no_thread() {
    let mut bench = Bench::new(queuing(1, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let _guest = bench.queuing_destination();
    let client = connect(&bench.path()).unwrap();
    bench.tick(&mut ports);
    flood(&client, 0);
    bench.ready(&mut ports);
    assert_eq!(account(&mut ports).messages, 1);
    assert_eq!(ports.epoll.wait(0, &mut [EpollEvent::default(); 4]).unwrap(), 0);
}

#[test]
fn of_a_thousand_connections_eight_live_and_the_port_goes_on() {
    let mut bench = Bench::new(SAMPLING, MAXIMUM, HostPort::Socket, false);
    let mut ports = bench.open();
    let mut guest = bench.sampling_source();
    guest.write(b"x", bench.stamp()).unwrap();
    let mut clients = Vec::new();
    while clients.len() < 1_000 {
        match connect(&bench.path()) {
            Ok(client) => clients.push(client),
            // The kernel keeps no more of them waiting.
            Err(error) if error.kind() == ErrorKind::WouldBlock => bench.tick(&mut ports),
            Err(error) => panic!("{error}"),
        }
    }
    bench.tick(&mut ports);
    assert_eq!(clients.iter().filter(|client| !client.is_closed()).count(), 8);
    assert_eq!(account(&mut ports).refused, 992);
    drop(clients);
    let client = connect(&bench.path()).unwrap();
    bench.tick(&mut ports);
    assert_eq!(message(&client), Some(b"x".to_vec()));
}

#[test]
fn clients_that_come_and_go_take_no_place_while_the_guest_does_not_listen() {
    let mut bench = Bench::new(queuing(4, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    for _ in 0..20 {
        drop(connect(&bench.path()).unwrap());
        bench.tick(&mut ports);
    }
    assert_eq!(account(&mut ports).refused, 0);
}

#[test]
fn a_guest_that_claims_the_impossible_is_counted_and_no_panic() {
    for kind in [SAMPLING, queuing(4, WhenFull::Refuse), queuing(4, WhenFull::Overwrite)] {
        let mut bench = Bench::new(kind, MAXIMUM, HostPort::Socket, false);
        let mut ports = bench.open();
        let client = connect(&bench.path()).unwrap();
        let mut own = bench.own();
        let mut random = 1u64;
        for n in 0..2_000u64 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(n | 1);
            let word = (random >> 33) as usize % own.words();
            let value = if n % 3 == 0 { random } else { random >> 60 };
            own.store(if n % 2 == 0 { word } else { offset::WRITTEN / 8 }, value);
            bench.tick(&mut ports);
            while let Some((header, message)) = packet(&client) {
                assert_eq!(header.length as usize, message.len());
                assert!((1..=MAXIMUM).contains(&header.length));
            }
        }
        assert!(account(&mut ports).hostile > 0, "{kind:?}");
    }
}

#[test]
fn a_guest_that_claims_to_have_read_what_was_never_sent_is_counted() {
    let mut bench = Bench::new(queuing(2, WhenFull::Refuse), MAXIMUM, HostPort::Socket, true);
    let mut ports = bench.open();
    let _guest = bench.queuing_destination();
    let client = connect(&bench.path()).unwrap();
    let sent = flood(&client, 0);
    let mut own = bench.own();
    for value in [u64::MAX, 1 << 63, 0, 5_000] {
        own.store(offset::READ / 8, value);
        bench.tick(&mut ports);
    }
    let account = account(&mut ports);
    assert!(account.hostile > 0 && account.messages < u64::from(sent), "{account:?}");
}
