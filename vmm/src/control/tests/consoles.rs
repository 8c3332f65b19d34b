//! Clients that are attached to consoles, the hostile ones too.

use super::super::client::PATIENCE;
use super::super::consoles::KEPT_BYTES;
use super::super::protocol::{Answer, ConsoleOutput, Request, TYPED_MAX, from_hex, hex};
use super::{Client, ErrorKind, ROOM, Served};

fn attach(served: &mut Served, client: &mut Client, partition: &str) -> (bool, u64, Vec<u8>) {
    client.send(&Request::Attach(partition.into()).line());
    served.serve();
    let Answer::Attached { console } = client.answer() else { panic!("not attached") };
    assert_eq!(console.partition, partition);
    (console.terminal, console.before, from_hex(&console.bytes).unwrap())
}

fn output(client: &mut Client) -> (String, u64, Vec<u8>) {
    let Answer::Console { console } = client.answer() else { panic!("no output") };
    let ConsoleOutput { partition, missed, bytes } = console;
    (partition, missed, from_hex(&bytes).unwrap())
}

#[test]
fn who_attaches_sees_what_was_there_and_what_comes_of_one_console() {
    let mut served = Served::new();
    served.server.console(1, "linux", b"linux# ");
    let (mut first, mut second) = (served.client(), served.client());
    assert_eq!(attach(&mut served, &mut first, "linux"), (true, 0, b"linux# ".to_vec()));
    assert_eq!(attach(&mut served, &mut second, "plc"), (false, 0, vec![]));
    served.server.console(0, "plc", b"scan\n");
    served.server.console(1, "linux", b"\xff\0");
    served.serve();
    assert_eq!(output(&mut first), ("linux".into(), 0, b"\xff\0".to_vec()));
    assert_eq!(output(&mut second), ("plc".into(), 0, b"scan\n".to_vec()));
    // The next one takes the place of the console before.
    attach(&mut served, &mut first, "plc");
    served.server.console(1, "linux", b"x");
    served.server.console(0, "plc", b"y");
    served.serve();
    assert_eq!(output(&mut first).0, "plc");
    first.send(&Request::Attach("other".into()).line());
    served.serve();
    assert_eq!(first.error(), ErrorKind::NoSuchPartition);
}

#[test]
fn what_is_typed_is_taken_as_far_as_there_is_room() {
    let mut served = Served::new();
    let mut client = served.client();
    for (bytes, taken) in [(&b"ls\n"[..], 3), (b"a longer line", ROOM as u64)] {
        client.send(&Request::Type("linux".into(), bytes.to_vec()).line());
        served.serve();
        assert_eq!(client.answer(), Answer::Typed { taken });
    }
    assert_eq!(served.run.typed, b"ls\na lon");
    let (long, odd) = (hex(&[b'x'; TYPED_MAX + 1]), "616".to_owned());
    for digits in [long, odd, String::new(), "g0".into(), "\u{e9}".into()] {
        let request = format!(
            "{{\"version\":2,\"request\":\"type\",\"partition\":\"linux\",\"data\":\"{digits}\"}}\n"
        );
        client.send(request.as_bytes());
        served.serve();
        assert_eq!(client.error(), ErrorKind::Malformed, "{digits}");
    }
}

#[test]
fn who_is_attached_and_reads_slowly_misses_bytes_and_knows_how_many() {
    let mut served = Served::new();
    let (mut slow, mut reader) = (served.client(), served.client());
    attach(&mut served, &mut slow, "linux");
    attach(&mut served, &mut reader, "linux");
    let line = [b'x'; 1_000];
    let turns = u64::from(PATIENCE) / 2;
    for _ in 0..turns {
        served.server.console(1, "linux", &line);
        served.serve();
        assert_eq!(output(&mut reader), ("linux".into(), 0, line.to_vec()));
    }
    let mut got = 0;
    for _ in 0..40 {
        got += output(&mut slow).2.len() as u64;
        served.serve();
    }
    served.server.console(1, "linux", b"end");
    served.serve();
    let missed = loop {
        let (_, missed, bytes) = output(&mut slow);
        if bytes == b"end" {
            break missed;
        }
        assert_eq!(missed, 0);
        got += bytes.len() as u64;
    };
    assert!(missed > 0, "all of it was kept for who did not read");
    assert_eq!(got + missed, 1_000 * turns);
}

#[test]
fn who_is_attached_and_never_reads_is_let_go_of() {
    let mut served = Served::new();
    let (mut silent, mut reader) = (served.client(), served.client());
    attach(&mut served, &mut silent, "linux");
    attach(&mut served, &mut reader, "linux");
    for _ in 0..2 * PATIENCE {
        served.server.console(1, "linux", &[b'x'; 1_000]);
        served.serve();
        output(&mut reader);
    }
    assert_eq!(served.server.clients(), 1);
}

#[test]
fn a_flood_of_attaching_costs_no_more_than_what_is_kept() {
    let mut served = Served::new();
    served.server.console(1, "linux", &[b'x'; 3 * KEPT_BYTES]);
    let mut greedy = served.client();
    for _ in 0..200 {
        greedy.send(&Request::Attach("linux".into()).line());
    }
    let mut answers = 0;
    while answers < 200 {
        served.serve();
        let Answer::Attached { console } = greedy.answer() else { panic!("not attached") };
        assert_eq!((console.before, console.bytes.len()), (2 * KEPT_BYTES as u64, 2 * KEPT_BYTES));
        answers += 1;
    }
}
