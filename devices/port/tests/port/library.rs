//! The library: taking ports, using them, waiting, and what is not believed.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use takt_port::channel::{
    Geometry, OpenError, Policy, ReadError, ReceiveError, ReturnCode, SendError, Validity, offset,
};
use takt_port::{CallError, Direction, PortError, Ports, PortsError, Start, Timeout};

use crate::loopback::{DEPTH, Loopback, MAXIMUM};

const SIZE: usize = MAXIMUM as usize;

fn open(folder: &Loopback) -> Ports {
    Ports::open(folder.path()).unwrap()
}

#[test]
fn a_sample_arrives_with_its_age() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let mut output = ports.output("out", Start::Attach).unwrap();
    let mut input = ports.input("in", Start::Attach).unwrap();
    assert_eq!(input.read(&mut [0; SIZE]), Err(ReadError::NeverWritten));
    output.write(b"level").unwrap();
    let mut buffer = [0; SIZE];
    let sample = input.read(&mut buffer).unwrap();
    assert_eq!((sample.bytes, sample.validity), (&b"level"[..], Validity::Valid));
    // The refresh period is a second by a clock of 1 GHz, which the counter surely reaches.
    let refresh = ports.clock().nanoseconds(input.status().refresh);
    assert_eq!(refresh, 1_000_000_000);
}

#[test]
fn a_message_arrives_and_an_empty_one_is_refused() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let mut sender = ports.sender("send", Start::Attach).unwrap();
    let error = sender.send(b"", Timeout::Zero).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::InvalidParam));
    sender.send(b"order", Timeout::Zero).unwrap();
    let mut receiver = ports.receiver("receive", Start::Attach).unwrap();
    assert_eq!(receiver.receive(&mut [0; SIZE], Timeout::Zero).unwrap().bytes, b"order");
}

#[test]
fn owners_follow_each_other_without_loss_and_open_empties() {
    let folder = Loopback::new();
    for n in 0..DEPTH as u8 {
        // A process each.
        open(&folder).sender("send", Start::Attach).unwrap().send(&[n], Timeout::Zero).unwrap();
    }
    for n in 0..2 {
        let ports = open(&folder);
        let mut receiver = ports.receiver("receive", Start::Attach).unwrap();
        assert_eq!(receiver.receive(&mut [0; SIZE], Timeout::Zero).unwrap().bytes, [n]);
    }
    let ports = open(&folder);
    let mut receiver = ports.receiver("receive", Start::Open).unwrap();
    let error = receiver.receive(&mut [0; SIZE], Timeout::Zero).unwrap_err();
    assert!(matches!(error, CallError::Receive(ReceiveError::Empty)), "{error}");
}

#[test]
fn an_end_has_one_owner_until_that_is_gone() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let others = open(&folder);
    let sender = ports.sender("send", Start::Attach).unwrap();
    for ports in [&ports, &others] {
        let error = ports.sender("send", Start::Attach).unwrap_err();
        assert!(matches!(&error, PortError::Busy(name) if name == "send"), "{error}");
        assert_eq!(error.code(), Some(ReturnCode::NoAction));
        // Another end is another matter.
        ports.receiver("receive", Start::Attach).unwrap();
    }
    let status = |name| others.status(others.port(name).unwrap()).unwrap();
    assert!(status("send").in_use && !status("receive").in_use);
    drop(sender);
    assert!(!status("send").in_use);
    others.sender("send", Start::Attach).unwrap();
}

#[test]
fn another_port_than_asked_for_says_what_there_is() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let error = ports.output("oil", Start::Attach).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::InvalidConfig));
    let text = "this partition has no port oil; it has out, in, send, receive, log, trail";
    assert_eq!(error.to_string(), text);
    let error = ports.output("send", Start::Attach).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::InvalidConfig));
    assert_eq!(error.to_string(), "port send is a queuing port");
    let error = ports.output("in", Start::Attach).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::InvalidMode));
    assert!(matches!(error, PortError::Direction { is: Direction::Destination, .. }));
}

#[test]
fn without_a_message_the_time_out_decides() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let mut receiver = ports.receiver("receive", Start::Attach).unwrap();
    let mut input = ports.input("in", Start::Attach).unwrap();
    let mut buffer = [0; SIZE];
    let error = receiver.receive(&mut buffer, Timeout::Zero).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::NotAvailable));
    let error = input.read_newer(&mut buffer, None, Timeout::Zero).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::NoAction));
    let before = Instant::now();
    let short = Timeout::Within(Duration::from_millis(10));
    let error = receiver.receive(&mut buffer, short).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::TimedOut));
    let error = input.read_newer(&mut buffer, None, short).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::TimedOut));
    assert!(before.elapsed() >= Duration::from_millis(20));
}

#[test]
fn without_room_the_time_out_decides_and_nothing_is_lost() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let mut sender = ports.sender("send", Start::Attach).unwrap();
    (0..DEPTH as u8).for_each(|n| sender.send(&[n], Timeout::Zero).unwrap());
    let error = sender.send(b"x", Timeout::Zero).unwrap_err();
    assert!(matches!(error, CallError::Send(SendError::Full)), "{error}");
    let error = sender.send(b"x", Timeout::Within(Duration::from_millis(5))).unwrap_err();
    assert_eq!(error.code(), Some(ReturnCode::TimedOut));
    assert_eq!(sender.status().waiting, DEPTH);
    // Room that comes while it waits.
    thread::scope(|scope| {
        let waiting = scope.spawn(|| sender.send(b"late", Timeout::Forever));
        let mut receiver = ports.receiver("receive", Start::Attach).unwrap();
        for n in 0..DEPTH as u8 {
            assert_eq!(receiver.receive(&mut [0; SIZE], Timeout::Zero).unwrap().bytes, [n]);
        }
        assert_eq!(receiver.receive(&mut [0; SIZE], Timeout::Forever).unwrap().bytes, b"late");
        waiting.join().unwrap().unwrap();
    });
}

#[test]
fn a_newer_sample_is_waited_for() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let mut output = ports.output("out", Start::Attach).unwrap();
    let mut input = ports.input("in", Start::Attach).unwrap();
    output.write(b"old").unwrap();
    let mut buffer = [0; SIZE];
    let known = Some(input.read_newer(&mut buffer, None, Timeout::Zero).unwrap().stamp);
    let error = input.read_newer(&mut buffer, known, Timeout::Zero).unwrap_err();
    assert!(matches!(error, CallError::NothingNewer), "{error}");
    thread::scope(|scope| {
        let waiting = scope.spawn(|| {
            let mut buffer = [0; SIZE];
            input.read_newer(&mut buffer, known, Timeout::Forever).map(|s| s.bytes.to_vec())
        });
        output.write(b"new").unwrap();
        assert_eq!(waiting.join().unwrap().unwrap(), b"new");
    });
}

#[test]
fn status_sees_without_taking_and_takes_nothing_from_the_owner() {
    let folder = Loopback::new();
    let ports = open(&folder);
    let status = |name| ports.status(ports.port(name).unwrap()).unwrap();
    ports.output("out", Start::Open).unwrap().write(b"level").unwrap();
    for name in ["out", "in"] {
        let seen = status(name);
        assert_eq!((seen.source_starts, seen.written, seen.waiting), (1, 1, None), "{name}");
        assert_eq!(seen.newest.unwrap().length, 5);
    }
    let mut log = ports.sender("log", Start::Open).unwrap();
    (0..10_u8).for_each(|n| log.send(&[n], Timeout::Zero).unwrap());
    for name in ["log", "trail"] {
        let seen = status(name);
        assert_eq!((seen.written, seen.waiting), (10, Some(u64::from(DEPTH))), "{name}");
        assert_eq!((seen.source_starts, seen.destination_starts), (1, Some(0)));
    }
    // The overflow is still told to the one that receives.
    let mut trail = ports.receiver("trail", Start::Attach).unwrap();
    let mut buffer = [0; SIZE];
    let received = trail.receive(&mut buffer, Timeout::Zero).unwrap();
    assert_eq!((received.bytes, received.overflowed), (&[6_u8][..], true));
}

#[test]
fn a_queue_that_both_ends_use_does_not_look_full() {
    let folder = Loopback::new();
    let (ports, others) = (open(&folder), open(&folder));
    let mut sender = ports.sender("send", Start::Attach).unwrap();
    let mut receiver = ports.receiver("receive", Start::Attach).unwrap();
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut buffer = [0; SIZE];
            while !done.load(Ordering::Relaxed) {
                sender.send(b"x", Timeout::Zero).unwrap();
                receiver.receive(&mut buffer, Timeout::Zero).unwrap();
            }
        });
        let port = others.port("send").unwrap();
        // An opening between the looks could be overtaken again and again; one in a hundred is many.
        let full = (0..2_000).filter(|_| others.status(port).unwrap().waiting > Some(1)).count();
        done.store(true, Ordering::Relaxed);
        assert!(full < 20, "{full}");
    });
    // A destination that lies.
    let queue = Geometry::queuing(MAXIMUM, DEPTH, Policy::Refuse).unwrap();
    let sample = Geometry::sampling(MAXIMUM).unwrap();
    let pages = [sample.source_bytes(), queue.source_bytes()].map(|b| b.next_multiple_of(4096));
    folder.damage(4096 + pages[0] + pages[1] + offset::READ, &(1_u64 << 40).to_le_bytes());
    assert_eq!(others.status(others.port("send").unwrap()).unwrap().waiting, Some(0));
}

#[test]
fn a_channel_whose_header_is_damaged_does_not_open() {
    let folder = Loopback::new();
    let ports = open(&folder);
    // The first region is that of `out`.
    folder.damage(4096 + offset::MAXIMUM, &[9]);
    for error in [
        ports.output("out", Start::Attach).map(drop).unwrap_err(),
        ports.input("in", Start::Open).map(drop).unwrap_err(),
    ] {
        assert!(
            matches!(error, PortError::Open { error: OpenError::Header { .. }, .. }),
            "{error}"
        );
        assert_eq!(error.code(), Some(ReturnCode::InvalidConfig));
    }
}

#[test]
fn a_folder_that_is_not_the_functions_is_refused() {
    let folder = Loopback::new();
    folder.damage(0, b"XXXX");
    let error = Ports::open(folder.path()).unwrap_err();
    assert!(matches!(error, PortsError::Table(_)), "{error}");
    std::fs::remove_file(folder.path().join("resource1")).unwrap();
    let error = Ports::open(folder.path()).unwrap_err();
    assert!(error.to_string().starts_with("cannot open "), "{error}");
    std::fs::write(folder.path().join("resource1"), b"").unwrap();
    let error = Ports::open(folder.path()).unwrap_err();
    assert!(error.to_string().starts_with("cannot map "), "{error}");
    std::fs::write(folder.path().join("resource1"), b"TAKT").unwrap();
    let error = Ports::open(folder.path()).unwrap_err();
    assert!(matches!(error, PortsError::Table(_)), "{error}");
}
