//! Both ends over a real line, in one thread: turn by turn.

use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::*;
use crate::connection::WINDOW;
use crate::frame::PAYLOAD_MAX;
use crate::line::{BYTES, Side};

/// A line with a file of its own.
pub(crate) fn line() -> (PathBuf, Line, Line) {
    static LINES: AtomicU32 = AtomicU32::new(0);
    let number = LINES.fetch_add(1, Ordering::Relaxed);
    let path = std::env::temp_dir().join(format!("takt-line-{}-{number}", std::process::id()));
    Line::make(&path).unwrap();
    let outside = Line::open(&path, Side::Outside).unwrap();
    let inside = Line::open(&path, Side::Inside).unwrap();
    (path, outside, inside)
}

/// Both ends, and the streams of which Takt is the other end.
struct Pair {
    path: PathBuf,
    outside: (Connections, Line),
    inside: (Connections, Line),
    takt: Vec<UnixStream>,
    now: Instant,
}

impl Pair {
    fn new() -> Self {
        let (path, outside, inside) = line();
        Self {
            path,
            outside: (Connections::new(), outside),
            inside: (Connections::new(), inside),
            takt: Vec::new(),
            now: Instant::now(),
        }
    }

    /// A client's end of a new connection.
    fn client(&mut self) -> UnixStream {
        let (client, carried) = UnixStream::pair().unwrap();
        client.set_nonblocking(true).unwrap();
        self.outside.0.add(carried);
        client
    }

    fn turn(&mut self) {
        let Self { outside, inside, takt, now, .. } = self;
        outside.0.turn(&mut outside.1, *now, || None);
        inside.0.turn(&mut inside.1, *now, || {
            let (carried, stream) = UnixStream::pair().unwrap();
            stream.set_nonblocking(true).unwrap();
            takt.push(stream);
            Some(carried)
        });
    }

    fn turns(&mut self, count: usize) {
        (0..count).for_each(|_| self.turn());
    }
}

impl Drop for Pair {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// What is there now, and whether it is the end.
fn read(stream: &mut UnixStream) -> (Vec<u8>, bool) {
    let mut all = Vec::new();
    match stream.read_to_end(&mut all) {
        Ok(_) => (all, true),
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::WouldBlock);
            (all, false)
        }
    }
}

#[test]
fn a_connection_is_carried_in_both_directions_and_to_its_end() {
    let mut pair = Pair::new();
    let mut client = pair.client();
    client.write_all(b"question\n").unwrap();
    pair.turns(2);
    let mut takt = pair.takt.remove(0);
    assert_eq!(read(&mut takt), (b"question\n".to_vec(), false));
    takt.write_all(b"answer\n").unwrap();
    pair.turns(2);
    assert_eq!(read(&mut client), (b"answer\n".to_vec(), false));

    // A client that has said all still gets what comes.
    client.shutdown(Shutdown::Write).unwrap();
    pair.turns(2);
    assert_eq!(read(&mut takt), (Vec::new(), true));
    takt.write_all(b"last\n").unwrap();
    drop(takt);
    pair.turns(3);
    assert_eq!(read(&mut client), (b"last\n".to_vec(), true));
    assert!(pair.outside.0.is_empty() && pair.inside.0.is_empty());
}

#[test]
fn many_bytes_arrive_in_order_whatever_the_pieces() {
    let mut pair = Pair::new();
    let mut client = pair.client();
    let sent: Vec<u8> = (0..4 * WINDOW + 4321).map(|n| (n * 7 + n / 251) as u8).collect();
    let (mut at, mut got) = (0, Vec::new());
    for turn in 0.. {
        assert!(turn < 1_000, "it does not end");
        at += client.write(&sent[at..(at + 10_007).min(sent.len())]).unwrap_or(0);
        pair.turn();
        if let Some(takt) = pair.takt.first_mut() {
            got.extend(read(takt).0);
        }
        if got.len() == sent.len() {
            break;
        }
    }
    assert!(got == sent);
}

#[test]
fn a_client_that_does_not_read_holds_up_no_other_and_is_let_go_of_in_time() {
    let mut pair = Pair::new();
    let _stalled = pair.client();
    pair.turns(2);
    let mut other = pair.client();
    pair.turns(2);
    let mut most = 0;
    for _ in 0..200 {
        // Takt sends as much as it can.
        while pair.takt[0].write(&[1; 4096]).is_ok() {}
        pair.takt[1].write_all(b"x").unwrap();
        pair.turn();
        most = most.max(pair.outside.0.kept() + pair.inside.0.kept());
    }
    pair.turns(3);
    assert_eq!(read(&mut other).0.len(), 200);
    assert!(most <= 2 * WINDOW, "{most} bytes are kept");
    assert_eq!((pair.outside.0.count(), pair.inside.0.count()), (2, 2));

    pair.now += Duration::from_secs(11);
    pair.turns(3);
    assert_eq!((pair.outside.0.count(), pair.inside.0.count()), (1, 1));
    pair.takt[1].write_all(b"y").unwrap();
    pair.turns(2);
    assert_eq!(read(&mut other), (b"y".to_vec(), false));
}

#[test]
fn more_clients_than_places_wait_and_no_connection_is_lost() {
    let mut pair = Pair::new();
    let mut clients: Vec<UnixStream> = (0..CONNECTIONS_MAX).map(|_| pair.client()).collect();
    assert!(!pair.outside.0.has_place());
    for client in &mut clients {
        client.write_all(b"?").unwrap();
    }
    // Not more than some are opened in a turn.
    pair.turn();
    assert_eq!(pair.takt.len(), OPENED_MAX);
    pair.turns(3);
    assert_eq!(pair.takt.len(), CONNECTIONS_MAX);
    assert!(pair.takt.iter_mut().all(|takt| read(takt).0 == b"?"));
    drop(clients);
    pair.turns(2);
    drop(std::mem::take(&mut pair.takt));
    pair.turns(4);
    assert!(pair.outside.0.is_empty() && pair.inside.0.is_empty());
}

#[test]
fn a_takt_that_does_not_answer_closes_the_clients_connection() {
    let (path, mut outside, mut inside) = line();
    let (mut there, mut here) = (Connections::new(), Connections::new());
    let (mut client, carried) = UnixStream::pair().unwrap();
    here.add(carried);
    let now = Instant::now();
    here.turn(&mut outside, now, || None);
    there.turn(&mut inside, now, || None);
    here.turn(&mut outside, now, || None);
    assert!(here.is_empty() && there.is_empty());
    assert_eq!(read(&mut client), (Vec::new(), true));
    std::fs::remove_file(path).unwrap();
}

#[test]
fn lies_of_the_other_end_are_bounded_and_leave_honest_connections_alone() {
    let (path, mut liar, mut line) = line();
    let mut connections = Connections::new();
    let now = Instant::now();
    let mut takt = Vec::new();
    let turn = |connections: &mut Connections, takt: &mut Vec<UnixStream>, line: &mut Line| {
        connections.turn(line, now, || {
            let (carried, stream) = UnixStream::pair().unwrap();
            takt.push(stream);
            Some(carried)
        });
        assert!(connections.count() <= CONNECTIONS_MAX);
        assert!(connections.kept() <= CONNECTIONS_MAX * WINDOW);
    };
    assert!(liar.send(Frame::Open(7)));
    turn(&mut connections, &mut takt, &mut line);
    let mut random = 1_u64;
    let mut next = |below: u64| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random % below
    };
    for _ in 0..20_000 {
        let id = [8, 9, 0, u32::MAX, next(64) as u32 + 100][next(5) as usize];
        let data = [next(256) as u8; PAYLOAD_MAX];
        // The answers are not taken for long at a time.
        if next(50) == 0 {
            while liar.receive().is_some() {}
        }
        match next(6) {
            0 => liar.send(Frame::Open(id)),
            1 => liar.send(Frame::Data(id, &data[..1 + next(4_000) as usize])),
            2 => liar.send(Frame::Room(id, next(u64::from(u32::MAX)) as u32)),
            3 => liar.send(Frame::End(id)),
            4 => liar.send(Frame::Ready),
            _ => liar.send(Frame::Gone(id)),
        };
        if next(4) == 0 {
            turn(&mut connections, &mut takt, &mut line);
        }
        // Only Takt's first connection is of interest.
        takt.truncate(1);
    }
    // Data beyond what there is room for ends the connection that it is for, and no other.
    for _ in 0..3 {
        while liar.receive().is_some() {}
        turn(&mut connections, &mut takt, &mut line);
    }
    assert!(liar.send(Frame::Data(7, b"honest")));
    turn(&mut connections, &mut takt, &mut line);
    takt[0].set_nonblocking(true).unwrap();
    assert_eq!(read(&mut takt[0]), (b"honest".to_vec(), false));
    std::fs::remove_file(path).unwrap();
}

#[test]
fn data_beyond_the_room_ends_its_connection() {
    let mut pair = Pair::new();
    let _client = pair.client();
    pair.turns(2);
    // Takt does not read, and its stream is full.
    let id = 1;
    for _ in 0..2_000 {
        pair.inside.1.receive();
        pair.outside.1.send(Frame::Data(id, &[0; PAYLOAD_MAX]));
        pair.inside.0.turn(&mut pair.inside.1, pair.now, || None);
        assert!(pair.inside.0.kept() <= WINDOW);
    }
    assert_eq!(pair.inside.0.count(), 0);
    pair.turns(3);
    assert!(pair.outside.0.is_empty());
}

#[test]
fn memory_that_the_other_end_has_damaged_is_stepped_over() {
    use std::os::unix::fs::FileExt;
    let (path, mut outside, mut inside) = line();
    let (mut here, mut there) = (Connections::new(), Connections::new());
    let (_client, carried) = UnixStream::pair().unwrap();
    here.add(carried);
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    let mut random = 99_u64;
    for round in 0..2_000_u64 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(round | 1);
        let at = random >> 20 & (BYTES as u64 - 8);
        file.write_all_at(&random.to_le_bytes(), at).unwrap();
        // The counters of both queues, too.
        file.write_all_at(
            &random.to_le_bytes(),
            [64, 72, 8192 + 80, 8192 + 72][round as usize % 4],
        )
        .unwrap();
        here.turn(&mut outside, Instant::now(), || None);
        there.turn(&mut inside, Instant::now(), || UnixStream::pair().ok().map(|(a, _)| a));
        assert!(there.count() <= CONNECTIONS_MAX && there.kept() <= CONNECTIONS_MAX * WINDOW);
    }
    std::fs::remove_file(path).unwrap();
}
