//! Requests of the control socket, as lines.

use takt_scheduler::time::Nanos;

use super::super::protocol::{ErrorKind, Mode, Request};

#[test]
fn each_request_has_one_line_and_one_meaning() {
    let plc = || "plc".to_owned();
    let golden = [
        (Request::Status, r#"{"version":2,"request":"status"}"#),
        (Request::Stop(plc()), r#"{"version":2,"request":"stop","partition":"plc"}"#),
        (
            Request::Start(plc(), Mode::Warm),
            r#"{"version":2,"request":"start","partition":"plc","mode":"warm"}"#,
        ),
        (
            Request::Restart(plc(), Mode::Cold),
            r#"{"version":2,"request":"restart","partition":"plc","mode":"cold"}"#,
        ),
        (
            Request::Schedule("night".into()),
            r#"{"version":2,"request":"schedule","schedule":"night"}"#,
        ),
        (
            Request::Trace(Nanos(1_000_000_000)),
            r#"{"version":2,"request":"trace","duration_ns":1000000000}"#,
        ),
        (Request::Events { follow: true }, r#"{"version":2,"request":"events","follow":true}"#),
    ];
    for (request, line) in golden {
        assert_eq!(String::from_utf8(request.line()).unwrap(), format!("{line}\n"));
        assert_eq!(Request::parse(line.as_bytes()), Ok(request));
    }
}

#[test]
fn what_may_be_left_out_has_a_default() {
    let start = br#"{"partition":"plc","request":"start","version":2}"#;
    assert_eq!(Request::parse(start), Ok(Request::Start("plc".into(), Mode::Cold)));
    let events = br#"{"version":2,"request":"events"}"#;
    assert_eq!(Request::parse(events), Ok(Request::Events { follow: false }));
}

#[test]
fn what_is_no_request_is_refused_for_the_right_reason() {
    use ErrorKind::{Malformed, UnknownRequest, Version};
    for (line, error) in [
        ("", Malformed),
        ("\0\u{7f}", Malformed),
        ("[1,\"status\"]", Malformed),
        ("null", Malformed),
        ("{\"version\":1,\"request\":\"status\"", Malformed),
        ("{}", Version),
        (r#"{"request":"status"}"#, Version),
        (r#"{"version":1,"request":"status","what":"ever"}"#, Version),
        (r#"{"version":"2","request":"status"}"#, Version),
        (r#"{"version":2.0,"request":"status"}"#, Version),
        (r#"{"version":2}"#, Malformed),
        (r#"{"version":2,"request":1}"#, Malformed),
        (r#"{"version":2,"request":"halt"}"#, UnknownRequest),
        (r#"{"version":2,"request":"Status"}"#, UnknownRequest),
        (r#"{"version":2,"request":"status","colour":"red"}"#, Malformed),
        (r#"{"version":2,"request":"status","partition":"plc"}"#, Malformed),
        (r#"{"version":2,"request":"stop"}"#, Malformed),
        (r#"{"version":2,"request":"stop","partition":7}"#, Malformed),
        (r#"{"version":2,"request":"stop","partition":"plc","mode":"cold"}"#, Malformed),
        (r#"{"version":2,"request":"restart","partition":"plc"}"#, Malformed),
        (r#"{"version":2,"request":"restart","partition":"plc","mode":"hot"}"#, Malformed),
        (r#"{"version":2,"request":"schedule","partition":"plc"}"#, Malformed),
        (r#"{"version":2,"request":"events","follow":1}"#, Malformed),
        (r#"{"version":2,"request":"events","duration_ns":1}"#, Malformed),
        (r#"{"version":2,"request":"trace"}"#, Malformed),
        (r#"{"version":2,"request":"trace","duration_ns":0}"#, Malformed),
        (r#"{"version":2,"request":"trace","duration_ns":-1}"#, Malformed),
        (r#"{"version":2,"request":"trace","duration_ns":1.5}"#, Malformed),
        (r#"{"version":2,"request":"trace","duration_ns":60000000001}"#, Malformed),
        (r#"{"version":2,"request":"trace","duration_ns":18446744073709551616}"#, Malformed),
    ] {
        assert_eq!(Request::parse(line.as_bytes()).map_err(|r| r.error), Err(error), "{line}");
    }
    let deep = [b'['; 60_000];
    assert_eq!(Request::parse(&deep).map_err(|r| r.error), Err(Malformed));
}
