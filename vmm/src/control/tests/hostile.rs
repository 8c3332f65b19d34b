//! Clients that hang, flood and lie harm only themselves.

use std::io::Write;

use takt_scheduler::time::Nanos;

use super::super::client::PATIENCE;
use super::super::protocol::{Answer, EventKind, LINE_MAX, Request, Values};
use super::super::server::CLIENTS_MAX;
use super::{Client, ErrorKind, Mode, Served};

fn is_served(served: &mut Served, client: &mut Client) {
    client.send(&Request::Status.line());
    served.serve();
    assert!(matches!(client.answer(), Answer::Status { .. }));
}

/// The generator of Marsaglia's "Xorshift RNGs" with the triple 13, 7, 17.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn garbage_is_answered_with_an_error_each_and_does_no_harm() {
    let mut served = Served::new();
    let (mut hostile, mut other) = (served.client(), served.client());
    let valid = Request::Restart("plc".into(), Mode::Cold).line();
    for seed in 1..=300 {
        let mut state = seed;
        // Random bytes, or a request with some of its bytes changed.
        let mut line: Vec<u8> = if seed % 2 == 0 {
            (0..random(&mut state) % 300).map(|_| random(&mut state) as u8).collect()
        } else {
            valid
                .iter()
                .map(|b| if random(&mut state).is_multiple_of(20) { b ^ 0x11 } else { *b })
                .collect()
        };
        line.retain(|byte| *byte != b'\n');
        line.push(b'\n');
        hostile.send(&line);
        served.serve();
        match hostile.answer() {
            Answer::Error(_) | Answer::Done { .. } => {}
            other => panic!("seed {seed}: {other:?}"),
        }
    }
    is_served(&mut served, &mut other);
    is_served(&mut served, &mut hostile);
}

#[test]
fn a_line_has_an_end_or_the_connection_has() {
    let mut served = Served::new();
    let mut client = served.client();
    let mut longest = Request::Status.line();
    longest.splice(..0, vec![b' '; LINE_MAX - longest.len()]);
    assert_eq!(longest.len(), LINE_MAX);
    client.send(&longest);
    served.serve();
    assert!(matches!(client.answer(), Answer::Status { .. }));

    longest.insert(0, b' ');
    client.send(&longest);
    served.serve();
    assert_eq!(client.error(), ErrorKind::TooLong);
    served.serve();
    assert_eq!(client.line(), None);

    let mut endless = served.client();
    endless.0.get_ref().set_nonblocking(true).unwrap();
    let mut sent = 0;
    let ended = (0..100).any(|_| {
        while let Ok(count) = endless.0.get_mut().write(&[b'x'; 4096]) {
            sent += count;
        }
        served.serve();
        matches!(endless.0.get_mut().write(b"x"), Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    });
    assert!(ended, "still there after {sent} bytes");
}

#[test]
fn who_does_not_read_is_let_go_of_when_the_events_pile_up() {
    let mut served = Served::new();
    let mut silent = served.client();
    silent.send(&Request::Events { follow: true }.line());
    served.serve();
    let text = "x".repeat(1000);
    let mut told = 0;
    while served.server.clients() > 0 {
        served.server.tell(Nanos(0), EventKind::Ended, None, &text);
        served.serve();
        told += 1;
        assert!(told < 10_000, "what it does not read is kept for ever");
    }
}

#[test]
fn who_does_not_read_its_answers_is_let_go_of_when_patience_ends() {
    let mut served = Served::new();
    let mut silent = served.client();
    silent.0.get_ref().set_nonblocking(true).unwrap();
    let requests = Request::Status.line().repeat(100);
    let mut turns = 0;
    while served.server.clients() > 0 || turns == 0 {
        let _ = silent.0.get_mut().write(&requests);
        served.serve();
        turns += 1;
        assert!(turns < 4 * PATIENCE, "a client that hangs has its place for ever");
    }
    assert!(turns > PATIENCE);
}

#[test]
fn one_client_too_many_is_told_so_and_another_gets_its_place_later() {
    let mut served = Served::new();
    let mut clients: Vec<Client> = (0..CLIENTS_MAX + 3).map(|_| served.client()).collect();
    served.serve();
    for refused in clients.split_off(CLIENTS_MAX).iter_mut() {
        assert_eq!(refused.error(), ErrorKind::Full);
        assert_eq!(refused.line(), None);
    }
    for client in &mut clients {
        is_served(&mut served, client);
    }
    clients.pop();
    served.serve();
    served.serve();
    let mut late = served.client();
    is_served(&mut served, &mut late);
}

#[test]
fn a_thousand_connections_are_survived() {
    let mut served = Served::new();
    let mut steady = served.client();
    is_served(&mut served, &mut steady);
    for _ in 0..1000 {
        let mut client = served.client();
        client.send(b"{");
        drop(client);
        served.serve();
    }
    is_served(&mut served, &mut steady);
    assert!(served.server.clients() <= CLIENTS_MAX);
}

/// A request for a change of a value.
fn force() -> Vec<u8> {
    let line = r#"{"version":2,"request":"force","partition":"plc","point":[0,3,0,4,255],"value":1,"name":"a","text":"1"}"#;
    [line.as_bytes(), b"\n"].concat()
}

#[test]
fn a_change_is_answered_when_it_is_done_and_holds_up_no_other_client() {
    let mut served = Served::new();
    let (mut waiting, mut other) = (served.client(), served.client());
    waiting.send(&force());
    waiting.send(&Request::Status.line());
    for _ in 0..3 {
        served.serve();
    }
    is_served(&mut served, &mut other);
    served.run.answered = 1;
    served.serve();
    assert!(matches!(waiting.answer(), Answer::Done { text } if text == "ticket 1"));
    served.serve();
    assert!(matches!(waiting.answer(), Answer::Status { .. }), "in the order of the requests");
}

#[test]
fn a_place_of_a_version_that_is_left_is_refused_until_the_status_is_asked_for() {
    let mut served = Served::new();
    let mut client = served.client();
    served.serve();
    served.run.answered = u64::MAX;
    served.server.unwatch(1, "it changes");
    served.serve();
    assert!(matches!(client.answer(), Answer::Error(refusal) if refusal.text == "it changes"));
    served.server.places_have_changed();
    let watch = |ranges: &str| {
        format!(r#"{{"version":2,"request":"watch","partition":"plc","ranges":[{ranges}]}}"#) + "\n"
    };
    for line in [force(), watch("[0,1,0,8]").into_bytes()] {
        client.send(&line);
        served.serve();
        let Answer::Error(refusal) = client.answer() else { panic!("refused") };
        assert!(refusal.text.contains("ask for it"), "{}", refusal.text);
    }
    assert!(served.run.asked.is_empty(), "{:?}", served.run.asked);
    // What ends something means no place that could be another's.
    client.send(watch("").as_bytes());
    served.serve();
    assert!(matches!(client.answer(), Answer::Watching { bytes: 0, .. }));
    client.send(&Request::Status.line());
    served.serve();
    assert!(matches!(client.answer(), Answer::Status { .. }));
    client.send(&force());
    served.serve();
    served.serve();
    assert!(matches!(client.answer(), Answer::Done { .. }));
}

#[test]
fn who_does_not_read_misses_values_and_is_told_how_many() {
    let mut served = Served::new();
    let mut silent = served.client();
    silent.send(
        b"{\"version\":2,\"request\":\"watch\",\"partition\":\"plc\",\"ranges\":[[0,1,0,8]]}\n",
    );
    served.serve();
    assert!(matches!(silent.answer(), Answer::Watching { bytes: 8, .. }));
    let mut made = 0;
    let mut tell = |served: &mut Served, lost| {
        served.server.values(1, lost, |missed| {
            made += 1;
            Values {
                partition: "plc".into(),
                cycle: made,
                release_ns: 0,
                time_ns: 0,
                missed,
                unsettled: 0,
                bytes: "00".repeat(1000),
            }
        });
        made
    };
    let told = (0..10_000).map(|_| tell(&mut served, 0)).last().unwrap();
    assert!(told < 2_000, "{told} lines are kept for a client that does not read");
    for _ in 0..told {
        assert!(matches!(silent.answer(), Answer::Values { .. }));
        served.serve();
    }
    tell(&mut served, 5);
    served.serve();
    let Answer::Values { values } = silent.answer() else { panic!("values") };
    assert_eq!((values.cycle, values.missed), (told + 1, 10_000 - told + 5));
}

#[test]
fn who_is_behind_is_told_why_the_watch_has_ended() {
    let mut served = Served::new();
    let mut silent = served.client();
    served.serve();
    // The socket takes some of these lines; the last is longer than the events with which a client may be behind.
    for cycle in 0..100 {
        let bytes = "00".repeat(takt_abi::live::SAMPLE_BYTES);
        served.server.values(1, 0, |missed| Values {
            partition: "plc".into(),
            cycle,
            release_ns: 0,
            time_ns: 0,
            missed,
            unsettled: 0,
            bytes,
        });
    }
    served.server.unwatch(1, "it changes");
    served.serve();
    let last = std::iter::from_fn(|| {
        let answer = silent.answer();
        served.serve();
        Some(answer)
    });
    let last = last.take(101).find(|answer| !matches!(answer, Answer::Values { .. }));
    assert!(matches!(last, Some(Answer::Error(refusal)) if refusal.text == "it changes"));
}

#[test]
fn a_million_requests_for_places_that_cannot_be_are_refused() {
    let count = if std::env::var_os("TAKT_TEST_LONG").is_some() { 1_000_000 } else { 20_000 };
    let valid = force();
    let mut state = 7;
    let mut parsed = 0;
    for _ in 0..count {
        let mut line = valid.clone();
        line.pop();
        for _ in 0..=random(&mut state) % 4 {
            let at = random(&mut state) as usize % line.len();
            line[at] = match random(&mut state) % 3 {
                0 => b'0' + (random(&mut state) % 10) as u8,
                1 => random(&mut state) as u8,
                _ => b"[],:-.e\""[random(&mut state) as usize % 8],
            };
        }
        let Ok(request) = Request::parse(&line) else { continue };
        parsed += 1;
        let again = request.line();
        assert_eq!(Request::parse(&again[..again.len() - 1]), Ok(request));
    }
    assert!(parsed > count / 100, "{parsed}");
}
