//! Clients of the control socket: order, events, and their ends.

use takt_scheduler::time::Nanos;

use super::super::protocol::{Answer, Event, EventKind, Mode, Request};
use super::super::server::KEPT;
use super::{ErrorKind, Served, status};

fn event(sequence: u64) -> Event {
    Event {
        sequence,
        at_ns: 7,
        kind: EventKind::Restarted,
        partition: Some("plc".into()),
        text: "warm start by an operator".into(),
    }
}

fn tell(served: &mut Served) {
    let text = "warm start by an operator";
    served.server.tell(Nanos(7), EventKind::Restarted, Some("plc"), text);
}

#[test]
fn requests_are_answered_in_order_however_they_are_cut() {
    let mut served = Served::new();
    let mut client = served.client();
    let requests = [
        Request::Status,
        Request::Stop("plc".into()),
        Request::Start("plc".into(), Mode::Cold),
        Request::Restart("plc".into(), Mode::Warm),
        Request::Schedule("night".into()),
        Request::Stop("linux".into()),
    ];
    let bytes = requests.iter().flat_map(Request::line).collect::<Vec<u8>>();
    for piece in bytes.chunks(7) {
        client.send(piece);
        served.serve();
    }
    assert_eq!(client.answer(), Answer::Status { status: Box::new(status()) });
    for text in ["stop plc", "start plc Cold", "restart plc Warm", "schedule night"] {
        assert_eq!(client.answer(), Answer::Done { text: text.into() });
    }
    assert_eq!(client.error(), ErrorKind::Unsupported);
    assert_eq!(served.run.asked.len(), 4);
}

#[test]
fn who_asks_all_at_once_waits_for_the_next_turns() {
    let mut served = Served::new();
    let mut client = served.client();
    client.send(&Request::Stop("plc".into()).line().repeat(9));
    let after_each_turn = [4, 8, 9, 9].map(|expected| {
        served.serve();
        (served.run.asked.len(), expected)
    });
    assert!(after_each_turn.iter().all(|(asked, expected)| asked == expected));
    assert!((0..9).all(|_| matches!(client.answer(), Answer::Done { .. })));
}

#[test]
fn who_follows_gets_what_was_and_what_comes() {
    let mut served = Served::new();
    tell(&mut served);
    let (mut one, mut two) = (served.client(), served.client());
    one.send(&Request::Events { follow: true }.line());
    two.send(&Request::Events { follow: false }.line());
    served.serve();
    for client in [&mut one, &mut two] {
        assert_eq!(client.answer(), Answer::Events { events: vec![event(1)] });
    }
    tell(&mut served);
    two.send(&Request::Status.line());
    served.serve();
    assert_eq!(one.answer(), Answer::Event { event: event(2) });
    assert!(matches!(two.answer(), Answer::Status { .. }), "it does not follow");
}

#[test]
fn only_the_latest_events_are_kept() {
    let mut served = Served::new();
    (0..KEPT + 3).for_each(|_| tell(&mut served));
    let mut client = served.client();
    client.send(&Request::Events { follow: false }.line());
    served.serve();
    let Answer::Events { events } = client.answer() else { panic!() };
    assert_eq!((events.len(), events[0].sequence), (KEPT, 4));
}

#[test]
fn who_closes_his_side_still_gets_his_answers_and_is_then_let_go_of() {
    let mut served = Served::new();
    let mut client = served.client();
    client.send(&Request::Status.line());
    client.0.get_ref().shutdown(std::net::Shutdown::Write).unwrap();
    served.serve();
    served.serve();
    assert!(matches!(client.answer(), Answer::Status { .. }));
    assert_eq!(client.line(), None);
}
