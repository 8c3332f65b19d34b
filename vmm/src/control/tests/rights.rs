//! Who may order, and who only sees.

use std::fs;
use std::io::Write;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use super::super::door::{Door, DoorError};
use super::super::protocol::{Area, Mode, Named, Point, PointValue, Range, Request};
use super::super::server::CLIENTS_MAX;
use super::{Answer, ErrorKind, Load, Nanos, Served};

/// A group that no test's user needs to be in, and a user who is in no other.
const GROUP: u32 = 54_321;
const USER: u32 = 54_322;

/// A server whose door the tests' user comes through as one who may only see.
fn for_viewers() -> Served {
    Served::behind(|socket| Door::open(socket, None).unwrap().owned_by(&[]))
}

fn range() -> Range {
    Range { program: 0, area: Area::State, offset: 0, bytes: 4 }
}

fn value() -> PointValue {
    let point = Point { range: range(), bit: None };
    let named = Named { name: "tank.level".into(), text: "1".into() };
    PointValue { partition: "plc".into(), point, value: 1, named }
}

/// Each request, and whether it orders something.
fn all() -> Vec<(Request, bool)> {
    let plc = || "plc".to_owned();
    let watch = Request::Watch { partition: plc(), ranges: vec![range()], interval: Nanos(0) };
    let load = Load { partition: plc(), program: plc(), part: 0, parts: 1, data: vec![1] };
    vec![
        (Request::Ping, false),
        (Request::Status, false),
        (Request::Events { follow: true }, false),
        (Request::Trace(Nanos::from_millis(1)), false),
        (watch, false),
        (Request::Versions(plc()), false),
        (Request::Stop(plc()), true),
        (Request::Start(plc(), Mode::Cold), true),
        (Request::Restart(plc(), Mode::Warm), true),
        (Request::Schedule(plc()), true),
        (Request::Attach(plc()), true),
        (Request::Type(plc(), vec![1]), true),
        (Request::Write(value()), true),
        (Request::Force(value()), true),
        (Request::Release(plc(), None), true),
        (Request::Load(load), true),
        (Request::Commit(plc(), plc()), true),
        (Request::RollBack(plc(), plc()), true),
    ]
}

#[test]
fn who_may_only_see_is_told_and_orders_nothing() {
    let mut served = for_viewers();
    for (request, orders) in all() {
        let before = served.run.asked.len();
        let mut client = served.client();
        client.send(&request.line());
        served.serve();
        if orders {
            assert_eq!(client.error(), ErrorKind::Refused, "{request:?}");
            assert_eq!(served.run.asked.len(), before, "{request:?}");
            assert!(served.run.typed.is_empty());
        } else {
            assert!(!matches!(client.answer(), Answer::Error(_)), "{request:?}");
        }
    }
}

#[test]
fn who_may_order_gets_each_answer() {
    let mut served = Served::new();
    served.run.answered = u64::MAX;
    for (request, _) in all() {
        let mut client = served.client();
        client.send(&request.line());
        served.serve();
        served.serve();
        assert!(!matches!(client.answer(), Answer::Error(_)), "{request:?}");
    }
}

#[test]
fn there_is_a_place_for_who_may_order_however_many_look() {
    let mut served = for_viewers();
    let mut clients: Vec<_> = (0..CLIENTS_MAX).map(|_| served.client()).collect();
    served.serve();
    assert_eq!(served.server.clients(), CLIENTS_MAX - 4);
    assert_eq!(clients.last_mut().unwrap().error(), ErrorKind::Full);
}

#[test]
fn the_group_of_the_file_may_connect_and_another_user_of_it_only_sees() {
    // SAFETY: takes nothing and cannot fail.
    if unsafe { libc::geteuid() } != 0 {
        return; // Only root can give a file to a group that it is not in, and be another user.
    }
    let mut served = Served::behind(|socket| Door::open(socket, Some("54321")).unwrap());
    let socket = served.folder.socket();
    let file = fs::symlink_metadata(&socket).unwrap();
    assert_eq!((file.gid(), file.permissions().mode() & 0o777), (GROUP, 0o660));
    let script = "import socket, sys\n\
        s = socket.socket(socket.AF_UNIX)\n\
        s.settimeout(60)\n\
        s.connect(sys.argv[1])\n\
        s.sendall(sys.stdin.buffer.read())\n\
        lines = s.makefile()\n\
        print(lines.readline() + lines.readline())\n";
    let run = |group: u32| {
        let mut python = Command::new("/usr/bin/python3");
        let python = python.args(["-c", script]).arg(&socket).uid(USER).gid(group);
        let pipes = python.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        pipes.spawn().unwrap()
    };
    let mut viewer = run(GROUP);
    let stop = Request::Stop("plc".into()).line();
    viewer.stdin.take().unwrap().write_all(&[Request::Ping.line(), stop].concat()).unwrap();
    while viewer.try_wait().unwrap().is_none() {
        served.serve();
    }
    let said = String::from_utf8(viewer.wait_with_output().unwrap().stdout).unwrap();
    assert!(
        said.contains("\"answer\":\"done\"") && said.contains("\"error\":\"refused\""),
        "{said}"
    );
    assert!(served.run.asked.is_empty());
    // The user who has started Takt, or root, orders as ever.
    let mut owner = served.client();
    owner.send(&Request::Stop("plc".into()).line());
    served.serve();
    assert_eq!(owner.answer(), Answer::Done { text: "stop plc".into() });
    // A user who is not in the group does not get in.
    assert!(!run(USER).wait_with_output().unwrap().status.success());
}

#[test]
fn a_group_that_does_not_exist_is_an_error_of_the_file_and_leaves_no_socket() {
    let folder = super::Folder::new();
    let error = Door::open(&folder.socket(), Some("no-such-group")).err().unwrap();
    assert!(matches!(error, DoorError::NoGroup(_)), "{error}");
    assert!(!folder.socket().exists());
}
