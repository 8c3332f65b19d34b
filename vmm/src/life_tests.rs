//! Every transition of a partition's life, as a table; and what the table cannot say.

use super::*;
use crate::health::ClockFault;

const FAULT: Detail = Detail::Clock(ClockFault::Rate { clock_ahead_ns: 40_000_000 });

fn finished(end: End) -> Finished {
    let at = Tsc(7);
    Finished { end, at, starting: false, noted: 0, cpu_time: Nanos(5) }
}

fn left(end: End, action: Option<Action>) -> Event {
    Event::Left { finished: finished(end), action, leaving: false }
}

/// Something that goes into the machine.
#[derive(Clone, Copy)]
enum Input {
    Order(Order),
    Event(Event),
}

fn put(life: &mut Life, input: Input) -> Result<Effects, Refused> {
    match input {
        Input::Order(order) => life.order(order),
        Input::Event(event) => Ok(life.step(event)),
    }
}

/// Each state that there is, and what leads to it.
fn states() -> Vec<(&'static str, Vec<Input>)> {
    let stop = Input::Order(Order::Stop);
    let restart = Input::Order(Order::Restart(StartMode::Warm));
    let fault = Input::Event(Event::HostFault(FAULT));
    let ended = |end| Input::Event(left(end, None));
    vec![
        ("running", vec![]),
        ("fault", vec![fault]),
        ("stopping", vec![stop]),
        ("stopping, fault", vec![stop, fault]),
        ("restarting", vec![restart]),
        ("restarting, fault", vec![restart, fault]),
        ("stopped", vec![stop, ended(End::Stopped)]),
        ("ended", vec![ended(End::PoweredOff)]),
        ("gone", vec![ended(End::NotLoaded)]),
    ]
}

/// Each event that there is.
fn inputs() -> Vec<(&'static str, Input)> {
    let own = |action| Input::Event(left(End::TripleFault, Some(action)));
    let leaving = Event::Left {
        finished: finished(End::TripleFault),
        action: Some(Action::ColdStart),
        leaving: true,
    };
    vec![
        ("order stop", Input::Order(Order::Stop)),
        ("order start", Input::Order(Order::Start(StartMode::Cold))),
        ("order restart", Input::Order(Order::Restart(StartMode::Cold))),
        ("host fault", Input::Event(Event::HostFault(FAULT))),
        ("left as asked", Input::Event(left(End::Stopped, None))),
        ("left, idle", own(Action::Idle)),
        ("left, cold-start", own(Action::ColdStart)),
        ("left, warm-start", own(Action::WarmStart)),
        ("left, shut-down", own(Action::ShutDown)),
        ("left, run ends", Input::Event(leaving)),
        ("left, schedule", Input::Event(left(End::ScheduleChange(StartMode::Warm), None))),
        ("run over", Input::Event(Event::RunOver)),
    ]
}

fn in_words(life: &Life) -> String {
    let state = match (life.phase, life.state()) {
        (Phase::Up { fault: Some(_), .. }, State::Running) => "fault".to_owned(),
        (Phase::Up { fault: Some(_), .. }, state) => format!("{state:?}, fault").to_lowercase(),
        (Phase::Down { finished, .. }, _) if finished.end == End::NotLoaded => "gone".to_owned(),
        (_, state) => format!("{state:?}").to_lowercase(),
    };
    if life.starts == Starts::None { format!("{state}, over") } else { state }
}

fn effects_in_words(effects: Result<Effects, Refused>) -> String {
    let effects = match effects {
        Ok(effects) => effects,
        Err(refused) => return format!("refused: {refused:?}"),
    };
    let Effects { halt, release, load, end_run, told } = effects;
    let mut words = Vec::new();
    words.extend(halt.then(|| "halt".to_owned()));
    words.extend(release.then(|| "release".to_owned()));
    words.extend(load.map(|Start { mode, reason }| format!("load {mode:?} {reason:?}")));
    words.extend(end_run.then(|| "end the run".to_owned()));
    words.extend(told.map(|told| match told {
        Told::Obeyed { instead, result } => {
            let how = instead.map(|end| format!(" instead {end}")).unwrap_or_default();
            match result {
                Ok(order) => format!("obeyed {order:?}{how}"),
                Err(refused) => format!("not obeyed {refused:?}{how}"),
            }
        }
        told => format!("{told:?}"),
    }));
    words.join("; ")
}

#[test]
fn every_event_in_every_state() {
    let mut table = String::new();
    for (name, way) in states() {
        for (event, input) in inputs() {
            let mut life = Life::new(Starts::ColdAndWarm);
            for step in &way {
                put(&mut life, *step).unwrap();
            }
            assert_eq!(in_words(&life), name);
            let before = life.clone();
            let effects = put(&mut life, input);
            if effects.is_err() {
                assert_eq!(life, before, "{name}, {event}: refused, and changed all the same");
            }
            let (to, effects) = (in_words(&life), effects_in_words(effects));
            table += format!("{name} | {event} | {to} | {effects}").trim_end();
            table.push('\n');
        }
    }
    assert_eq!(table, include_str!("life_tests.txt"), "{table}");
}

#[test]
fn what_cannot_be_loaded_is_not_started() {
    let mut life = Life::new(Starts::None);
    assert_eq!(life.order(Order::Restart(StartMode::Cold)), Err(Refused::RunEnds));
    let effects = life.step(left(End::TripleFault, Some(Action::ColdStart)));
    assert_eq!((effects.load, effects.told), (None, Some(Told::Ended)));
    assert_eq!(life.order(Order::Start(StartMode::Cold)), Err(Refused::RunEnds));
    assert_eq!(life.restarts(), 0);
}

#[test]
fn what_retains_nothing_has_no_warm_start() {
    let mut life = Life::new(Starts::Cold);
    assert_eq!(life.order(Order::Restart(StartMode::Warm)), Err(Refused::NoWarmStart));
    assert!(life.order(Order::Restart(StartMode::Cold)).is_ok());
}

#[test]
fn an_error_of_the_hosts_is_the_end_only_of_a_guest_that_it_has_ended() {
    let mut life = Life::new(Starts::ColdAndWarm);
    let stopped = finished(End::Stopped);
    assert_eq!(life.cause(stopped), stopped);
    let _ = life.step(Event::HostFault(FAULT));
    assert_eq!(life.cause(stopped).end, End::Raised(FAULT));
    assert_eq!(life.cause(finished(End::Reset)).end, End::Reset);
    // The next end has its own reason.
    let _ = life.step(left(End::Raised(FAULT), Some(Action::ColdStart)));
    assert_eq!(life.cause(stopped), stopped);
}

#[test]
fn starts_are_counted_and_the_last_one_is_known() {
    let mut life = Life::new(Starts::ColdAndWarm);
    assert_eq!((life.restarts(), life.start_mode(), life.finished()), (0, StartMode::Cold, None));
    let _ = life.step(left(End::Reset, Some(Action::WarmStart)));
    assert_eq!((life.restarts(), life.start_mode(), life.finished()), (1, StartMode::Warm, None));
    let _ = life.step(left(End::Exited(0), Some(Action::Idle)));
    assert_eq!(life.finished(), Some(finished(End::Exited(0))));
    life.order(Order::Start(StartMode::Cold)).unwrap();
    assert_eq!((life.restarts(), life.start_mode(), life.finished()), (2, StartMode::Cold, None));
    assert!(!life.ended_run());
    let _ = life.step(left(End::TripleFault, Some(Action::ShutDown)));
    assert!(life.ended_run());
}
