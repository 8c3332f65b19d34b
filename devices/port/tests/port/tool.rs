//! The tool as a shell sees it: what it prints and how it ends.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use crate::loopback::{DEPTH, Loopback};

fn tool(folder: &Loopback, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt-port"));
    command.arg("--function").arg(folder.path()).args(arguments).stdin(Stdio::null());
    command
}

fn run(folder: &Loopback, arguments: &[&str]) -> Output {
    tool(folder, arguments).output().unwrap()
}

/// With something on standard input.
fn run_with(folder: &Loopback, arguments: &[&str], input: &[u8]) -> Output {
    let mut command = tool(folder, arguments);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // A tool that does not read is a tool that has failed, which its status tells.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

/// The standard output of a call that must succeed.
fn shown(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Exit status and message of a call that must fail.
fn refused(output: &Output) -> (i32, String) {
    assert!(output.stdout.is_empty(), "{output:?}");
    (output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_loop_of_calls_loses_nothing() {
    let folder = Loopback::new();
    for round in 0..5 {
        for n in 0..DEPTH {
            shown(&run(&folder, &["send", "send", &format!("{round}.{n}")]));
        }
        for n in 0..DEPTH {
            assert_eq!(shown(&run(&folder, &["recv", "receive"])), format!("{round}.{n}"));
        }
    }
}

#[test]
fn each_failure_has_the_number_of_its_return_code() {
    let folder = Loopback::new();
    let too_long = "x".repeat(513);
    for (arguments, status, says) in [
        (&["read", "in"][..], 1, "in: nothing has been written yet"),
        (&["recv", "receive"], 2, "receive: no message is waiting"),
        (&["send", "send", ""], 3, "a message has at least one byte"),
        (&["write", "out", &too_long], 4, "a message of 513 bytes, the channel takes 512"),
        (&["read", "nothing"], 4, "this partition has no port nothing; it has out, in"),
        (&["read", "receive"], 4, "port receive is a queuing port"),
        (&["read", "out"], 5, "port out is a source"),
        (&["send", "receive", "x"], 5, "port receive is a destination"),
        (&["recv", "receive", "--timeout", "5ms"], 6, "receive: the time-out passed"),
        (&["watch", "in", "--timeout", "5ms"], 6, "in: the time-out passed"),
        (&["recv", "receive", "--timeout", "soon"], 64, "allowed is 0, forever, or a number"),
        (&["recv", "receive", "--raw", "--json"], 64, "cannot be used with"),
        (&["write", "out", "1", "--layout", "a:float"], 64, "there is no type float"),
        (&["write", "out", "0", "--hex"], 64, "0: not pairs of hexadecimal digits"),
        (&["dance"], 64, "unrecognized subcommand"),
        (&["recv", "receive", "--count", "0"], 64, "--count"),
    ] {
        let (found, message) = refused(&run(&folder, arguments));
        assert_eq!(found, status, "{arguments:?}: {message}");
        assert!(message.contains(says), "{arguments:?}: {message}");
    }
    for _ in 0..DEPTH {
        shown(&run(&folder, &["send", "send", "x"]));
    }
    let (status, message) = refused(&run(&folder, &["send", "send", "x"]));
    assert_eq!((status, message.as_str()), (2, "takt-port: send: the queue is full\n"));
    assert_eq!(refused(&run(&folder, &["send", "send", "x", "--timeout", "5ms"])).0, 6);
}

#[test]
fn a_port_in_use_is_no_action() {
    let folder = Loopback::new();
    let ports = takt_port::Ports::open(folder.path()).unwrap();
    let _sender = ports.sender("send", takt_port::Start::Attach).unwrap();
    let (status, message) = refused(&run(&folder, &["send", "send", "x"]));
    assert_eq!((status, message.contains("port send is in use")), (1, true), "{message}");
}

#[test]
fn without_the_function_the_tool_says_what_to_look_at() {
    let output = Command::new(env!("CARGO_BIN_EXE_takt-port")).arg("list").output().unwrap();
    let (status, message) = refused(&output);
    assert_eq!(status, 70, "{message}");
    assert!(message.contains("has a [[channel]] of its partition file an end in it?"), "{message}");
}

#[test]
fn list_and_status_show_every_port() {
    let folder = Loopback::new();
    let list = shown(&run(&folder, &["list"]));
    assert_eq!(
        list,
        "PORT     KIND      DIRECTION    BYTES  DEPTH  POLICY     REFRESH     DOORBELL\n\
         out      sampling  source       512    -      -          1000.000ms  yes\n\
         in       sampling  destination  512    -      -          1000.000ms  yes\n\
         send     queuing   source       512    4      refuse     -           yes\n\
         receive  queuing   destination  512    4      refuse     -           yes\n\
         log      queuing   source       512    4      overwrite  -           yes\n\
         trail    queuing   destination  512    4      overwrite  -           yes\n"
    );
    shown(&run(&folder, &["send", "send", "x", "--count", "3"]));
    let status = shown(&run(&folder, &["status", "receive", "--json"]));
    let expected = r#"{"port":"receive","in_use":false,"source_starts":0,"destination_starts":0,"written":3,"waiting":3}"#;
    assert_eq!(status.trim_end(), expected);
    assert_eq!(shown(&run(&folder, &["status"])).lines().count(), 7);
    // Looking took nothing.
    assert_eq!(shown(&run(&folder, &["recv", "receive", "--count", "3"])), "xxx");
}

#[test]
fn fields_go_through_a_channel_as_text_and_as_json() {
    let folder = Loopback::new();
    let layout = "level:lreal[32], n:dint[64]";
    let numbers = |count| (0..count).map(|n| n.to_string()).collect::<Vec<_>>().join(",");
    let line = format!("level={} n={}\n", numbers(32), numbers(64));
    let file = folder.path().join("layout");
    std::fs::write(&file, "level:lreal[32]\nn:dint[64]\n").unwrap();
    let from_file = format!("@{}", file.display());
    shown(&run_with(&folder, &["write", "out", "--layout", layout], line.as_bytes()));
    assert_eq!(shown(&run(&folder, &["read", "in", "--layout", &from_file])), line);
    let json = shown(&run(&folder, &["read", "in", "--layout", layout, "--json"]));
    assert!(json.starts_with(r#"{"port":"in","code":0,"age_ns":"#), "{json}");
    assert!(json.contains(r#""valid":true,"fields":{"level":[0.0,1.0,"#), "{json}");
    // What was read is what can be sent on.
    shown(&run_with(&folder, &["send", "send", "--layout", layout, "--json"], json.as_bytes()));
    assert_eq!(shown(&run(&folder, &["recv", "receive", "--layout", layout])), line);
    let (status, message) = refused(&run(&folder, &["read", "in", "--layout", "a:int"]));
    assert_eq!((status, message.contains("the message has 512 bytes, the layout 2")), (70, true));
}

#[test]
fn watch_shows_what_comes_while_it_waits() {
    let folder = Loopback::new();
    let arguments = ["watch", "receive", "--count", "6", "--hex"];
    let watching = tool(&folder, &arguments).stdout(Stdio::piped()).spawn().unwrap();
    let lines: Vec<u8> = (0..6).flat_map(|n| format!("0{n}\n").into_bytes()).collect();
    shown(&run_with(&folder, &["send", "send", "--hex", "--timeout", "forever"], &lines));
    let output = watching.wait_with_output().unwrap();
    assert_eq!(shown(&output).into_bytes(), lines);
}

#[test]
fn a_message_that_is_not_of_the_layout_is_told_as_digits_and_watch_goes_on() {
    let folder = Loopback::new();
    let send = |message: &str| shown(&run(&folder, &["send", "send", "--hex", message]));
    send("0102ff");
    let recv = ["recv", "receive", "--layout", "n:int"];
    let expected = "takt-port: receive: the message has 3 bytes, the layout 2; it is 0102ff\n";
    assert_eq!(refused(&run(&folder, &recv)), (70, expected.to_owned()));
    for message in ["0100", "0102ff", "0200"] {
        send(message);
    }
    let watch = ["watch", "receive", "--layout", "n:int", "--count", "3"];
    let output = run(&folder, &watch);
    assert_eq!(output.status.code(), Some(70), "{output:?}");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "n=1\nn=2\n");
    let expected = format!("{expected}takt-port: receive: messages that could not be shown: 1\n");
    assert_eq!(String::from_utf8_lossy(&output.stderr), expected);
    for message in ["0100", "0200", "0300"] {
        send(message);
    }
    assert_eq!(shown(&run(&folder, &watch)), "n=1\nn=2\nn=3\n");
}

#[test]
fn an_overflow_is_told_with_the_message_behind_it() {
    let folder = Loopback::new();
    shown(&run_with(&folder, &["send", "log", "--hex"], b"00\n01\n02\n03\n04\n05"));
    let output = run(&folder, &["recv", "trail", "--json"]);
    let text = shown(&output);
    assert!(text.contains(r#""code":4"#) && text.contains(r#""bytes":"02""#), "{text}");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(errors.contains("trail: messages before this one were overwritten"), "{errors}");
    let text = shown(&run(&folder, &["recv", "trail", "--json"]));
    assert!(text.contains(r#""code":0"#) && !text.contains("valid"), "{text}");
}

#[test]
fn open_begins_anew() {
    let folder = Loopback::new();
    shown(&run(&folder, &["send", "send", "old"]));
    shown(&run(&folder, &["send", "send", "new", "--open"]));
    assert_eq!(shown(&run(&folder, &["recv", "receive", "--count", "1"])), "new");
    shown(&run(&folder, &["send", "send", "old"]));
    assert_eq!(refused(&run(&folder, &["recv", "receive", "--open"])).0, 2);
}

#[test]
fn what_a_hostile_end_writes_is_a_failed_call_and_no_more() {
    let folder = Loopback::new();
    shown(&run(&folder, &["write", "out", "x"]));
    // `written` of the first region, far ahead.
    folder.damage(4096 + 80, &[0xff; 8]);
    let (status, message) = refused(&run(&folder, &["read", "in"]));
    assert_eq!((status, message.contains("impossible claim")), (2, true), "{message}");
    shown(&run(&folder, &["status"]));
    // The source notices that its counters contradict each other, and begins anew.
    shown(&run(&folder, &["write", "out", "y"]));
    assert_eq!(shown(&run(&folder, &["read", "in"])), "y");
}
