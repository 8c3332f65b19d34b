//! Traces: what is told, to whom, how long, and what becomes of what is not read.

use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Nanos, Tsc};

use super::super::protocol::{Answer, EventKind, Request, TracedWindow};
use super::{Client, ErrorKind, Served, trace_start};
use crate::vcpu::record::{DETOURS_MAX, Detour, Exit, Scan, WindowRecord};

const SECOND: Nanos = Nanos::from_millis(1000);

fn window(sequence: u64) -> (WindowRecord, Vec<Detour>) {
    let record = WindowRecord {
        sequence,
        schedule: ScheduleId(0),
        skipped: 1,
        release: Tsc(u64::MAX - 10),
        end: Tsc(u64::MAX - 1),
        due: Tsc(2),
        woken: Tsc(3),
        entered: Tsc(4),
        left: Tsc(5),
        kicked: Some(Tsc(6)),
        claim: Some(Scan { start: Tsc(7), done: Tsc(8) }),
        last_stamp: Tsc(9),
        exits: 10,
        kernel_exits: 11,
        overrun: true,
        unfinished: false,
        has_tasks: false,
        ended: false,
    };
    let exits = [Exit::Port(0x7a10), Exit::Memory(1 << 40), Exit::Signal, Exit::Other];
    let detour = |exit| Detour { exit, left: Tsc(12), entered: Tsc(13) };
    (record, exits.map(detour).to_vec())
}

fn tell(served: &mut Served, sequence: u64) {
    let (record, detours) = window(sequence);
    served.server.window(|| TracedWindow::new("plc", "normal", &record, &detours));
}

/// A client whose trace has begun.
fn tracer(served: &mut Served) -> Client {
    let mut client = served.client();
    client.send(&Request::Trace(SECOND).line());
    served.serve();
    assert_eq!(client.answer(), Answer::Trace { trace: trace_start() });
    client
}

#[test]
fn who_traces_is_told_of_each_window_until_its_time_is_over() {
    let mut served = Served::new();
    served.run.now = Nanos(5);
    tell(&mut served, 1);
    let (mut client, mut other) = (tracer(&mut served), served.client());
    tell(&mut served, 2);
    served.server.switch(Tsc(70), "night");
    tell(&mut served, 3);
    served.run.now = Nanos(4).plus(SECOND);
    served.serve();
    tell(&mut served, 4);
    served.run.now = Nanos(5).plus(SECOND);
    served.serve();
    tell(&mut served, 5);
    other.send(&Request::Status.line());
    served.serve();
    for expected in [2, 3, 4] {
        if expected == 3 {
            let switch = Answer::Switch { at_tsc: 70, schedule: "night".into() };
            assert_eq!(client.answer(), switch);
        }
        let Answer::Window { window: told } = client.answer() else { panic!() };
        assert_eq!(told.dropped_before, 0);
        let (record, detours) = window(expected);
        assert_eq!(told.record(&trace_start()), Some((PartitionId(0), record, detours)));
    }
    assert_eq!(client.answer(), Answer::Traced { windows: 3, dropped: 0 });
    assert!(matches!(other.answer(), Answer::Status { .. }), "it does not trace");
}

#[test]
fn there_is_one_trace_at_a_time() {
    let mut served = Served::new();
    let (mut first, mut second) = (tracer(&mut served), served.client());
    for client in [&mut first, &mut second] {
        client.send(&Request::Trace(SECOND).line());
        served.serve();
        assert_eq!(client.error(), ErrorKind::Refused);
    }
    drop(first);
    served.serve();
    tell(&mut served, 1);
    served.serve();
    second.send(&Request::Trace(SECOND).line());
    served.serve();
    assert!(matches!(second.answer(), Answer::Trace { .. }));
}

#[test]
fn who_asks_and_closes_its_side_still_gets_its_trace() {
    let mut served = Served::new();
    let mut client = served.client();
    client.send(&Request::Trace(SECOND).line());
    client.0.get_ref().shutdown(std::net::Shutdown::Write).unwrap();
    (0..3).for_each(|_| served.serve());
    tell(&mut served, 1);
    served.run.now = SECOND;
    served.serve();
    served.serve();
    assert!(matches!(client.answer(), Answer::Trace { .. }));
    assert!(matches!(client.answer(), Answer::Window { .. }));
    assert_eq!(client.answer(), Answer::Traced { windows: 1, dropped: 0 });
    assert_eq!(client.line(), None);
}

#[test]
fn what_a_slow_client_does_not_take_is_dropped_and_counted() {
    let mut served = Served::new();
    let mut client = tracer(&mut served);
    client.send(&Request::Events { follow: true }.line());
    served.serve();
    assert!(matches!(client.answer(), Answer::Events { .. }));
    for sequence in 0..10_000 {
        tell(&mut served, sequence);
    }
    // It misses windows, but no event, and keeps its place.
    served.server.tell(Nanos(0), EventKind::Schedule, None, "x");
    assert_eq!(served.server.clients(), 1);
    let (mut told, mut dropped, mut next) = (0, 0, 0);
    let mut event = false;
    while !event {
        served.serve();
        match client.answer() {
            Answer::Window { window } => {
                assert_eq!(window.dropped_before, 0, "all that is dropped comes after");
                assert_eq!(window.release, next);
                (told, next) = (told + 1, next + 1);
            }
            Answer::Event { .. } => event = true,
            other => panic!("{other:?}"),
        }
    }
    assert!((10..9_000).contains(&told), "{told}");
    tell(&mut served, 10_000);
    served.run.now = SECOND;
    served.serve();
    let Answer::Window { window } = client.answer() else { panic!() };
    assert_eq!((window.release, window.dropped_before), (10_000, 10_000 - told));
    dropped += window.dropped_before;
    assert_eq!(client.answer(), Answer::Traced { windows: told + 1, dropped });
}

#[test]
fn a_window_that_cannot_be_is_not_rebuilt() {
    let (record, detours) = window(1);
    let good = TracedWindow::new("plc", "normal", &record, &detours);
    assert!(good.record(&trace_start()).is_some());
    let spoilt = |spoil: &dyn Fn(&mut TracedWindow)| {
        let mut window = good.clone();
        spoil(&mut window);
        window.record(&trace_start())
    };
    assert_eq!(spoilt(&|w| w.partition = "unknown".into()), None);
    assert_eq!(spoilt(&|w| w.schedule = "never".into()), None);
    assert_eq!(spoilt(&|w| w.detours[0].at = Some(0x1_0000)), None);
    assert_eq!(spoilt(&|w| w.detours[0].at = None), None);
    assert_eq!(spoilt(&|w| w.detours[2].at = Some(1)), None);
    assert_eq!(spoilt(&|w| w.detours = vec![w.detours[0]; DETOURS_MAX as usize + 1]), None);
    let mut start = trace_start();
    start.tsc_khz = 0;
    assert_eq!(start.base(), None);
}
