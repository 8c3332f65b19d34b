//! Orders to a partition whose thread is this one.

use takt_devices::output;
use takt_scheduler::time::{Nanos, Tsc};

use super::super::Orders;
use super::super::protocol::{ErrorKind, EventKind, State};
use crate::account::{Account, Finished};
use crate::boot::StartMode;
use crate::boot::plc::{PlcImage, Source};
use crate::handoff::handoff;
use crate::health::{Table, Watch};
use crate::memory::{GuestMemory, Pages};
use crate::restart::{PlcLoader, Restart, Revivals};
use crate::terminal::Lines;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::guest::End;
use crate::vcpu::plc::PlcGuest;
use takt_record::WindowAssembler;

const RAM: u64 = 4 << 20;

fn account() -> (Account, Revivals<PlcGuest>) {
    let memory = GuestMemory::for_plc(RAM, Pages::Small, &[]).unwrap();
    let image = PlcImage::read(Source::Demo, RAM).unwrap();
    let processor = FirstState::none();
    let loader =
        PlcLoader { memory, image, programs: None, channels: Vec::new(), space: None, processor };
    let spawn = |_: &str, _, work: Box<dyn FnOnce() + Send>| {
        std::thread::spawn(work);
        Ok(())
    };
    let (restart, revivals) = Restart::new(loader, &spawn).unwrap();
    let (_, output) = output::dropping();
    let account = Account {
        name: "plc".into(),
        control: std::sync::Arc::default(),
        output,
        unshown: 0,
        is_terminal: false,
        records: None,
        assembler: WindowAssembler::default(),
        says_done: true,
        health: Watch::new(Table::PLC).0,
        releases: None,
        samples: None,
        load: None,
        occupied: Nanos::ZERO,
        watchdog: None,
        kernel: None,
        deadlines: None,
        banks: None,
        power_button: None,
        restart: Some(restart),
        restarts: 0,
        finished: None,
        ends: handoff(1).1,
        ended_run: false,
        start_mode: StartMode::Cold,
        orders: Orders::default(),
        host_fault: None,
        lines: Lines::default(),
    };
    (account, revivals)
}

fn finished(end: End) -> Finished {
    let at = Tsc(0);
    Finished { end, at, starting: false, noted: 0, cpu_time: Nanos(5), unrecorded: 0 }
}

#[test]
fn a_partition_stops_when_its_thread_says_so_and_can_be_started() {
    let (mut plc, mut revivals) = account();
    assert_eq!(plc.order_start(StartMode::Cold).unwrap_err().error, ErrorKind::Refused);
    plc.order_stop().unwrap();
    assert!(plc.control.stopping());
    assert_eq!(plc.state(), State::Stopping);
    assert_eq!(plc.order_stop().unwrap_err().error, ErrorKind::Refused);
    assert!(plc.order_restart(StartMode::Cold).is_err(), "one order at a time");

    let outcome = plc.obey(finished(End::Stopped)).unwrap();
    assert_eq!(
        (outcome.kind, outcome.text.as_str()),
        (EventKind::Stopped, "stopped by an operator")
    );
    assert_eq!((plc.state(), plc.orders.stopped()), (State::Stopped, true));
    assert_eq!(plc.end().unwrap(), "stopped by an operator");
    assert_eq!(plc.cpu_time(), Nanos(5));
    assert!(revivals.take().unwrap().is_none());

    let outcome = plc.order_start(StartMode::Warm).unwrap();
    assert_eq!(outcome.text, "warm start by an operator");
    assert!(revivals.wait(None).is_ok());
    assert!(!plc.control.stopping(), "its thread would stop at once");
    assert_eq!((plc.state(), plc.restarts, plc.end()), (State::Running, 1, None));
    assert_eq!(plc.start_mode, StartMode::Warm);
    assert!(!plc.orders.stopped());
}

#[test]
fn a_restart_comes_after_the_stop() {
    let (mut plc, mut revivals) = account();
    assert_eq!(plc.order_restart(StartMode::Cold), Ok(None));
    assert_eq!(plc.state(), State::Restarting);
    assert!(revivals.take().unwrap().is_none());
    let outcome = plc.obey(finished(End::Stopped)).unwrap();
    assert_eq!(
        (outcome.kind, outcome.text.as_str()),
        (EventKind::Restarted, "cold start by an operator")
    );
    assert!(revivals.wait(None).is_ok());
    assert!(!plc.control.stopping(), "its thread would stop at once");
    assert_eq!(plc.state(), State::Running);
    assert_eq!(plc.obey(finished(End::Stopped)), None, "an order is carried out once");
}

#[test]
fn an_end_of_its_own_is_told_though_an_order_came_at_the_same_time() {
    let (mut plc, _revivals) = account();
    plc.order_stop().unwrap();
    let outcome = plc.obey(finished(End::TripleFault)).unwrap();
    assert_eq!(outcome.text, "triple fault; stopped by an operator");
    assert_eq!(plc.end().unwrap(), "triple fault");
}

#[test]
fn what_has_ended_by_itself_can_be_started() {
    let (mut plc, mut revivals) = account();
    plc.finished = Some(finished(End::Exited(3)));
    assert_eq!(plc.state(), State::Ended);
    assert!(plc.order_restart(StartMode::Cold).unwrap().is_some());
    assert!(revivals.wait(None).is_ok());
    assert_eq!(plc.state(), State::Running);
}

#[test]
fn a_thread_that_is_gone_starts_nothing() {
    let (mut plc, _revivals) = account();
    plc.finished = Some(finished(End::NotLoaded));
    let refusal = plc.order_start(StartMode::Cold).unwrap_err();
    assert!(refusal.text.contains("gone"), "{}", refusal.text);
    assert_eq!(plc.state(), State::Ended);
}

#[test]
fn at_the_end_of_the_run_orders_are_forgotten() {
    let (mut plc, _revivals) = account();
    plc.order_restart(StartMode::Cold).unwrap();
    plc.orders.forget();
    assert_eq!(plc.obey(finished(End::Stopped)), None);
}

/// More starts than any block of a channel holds, each with a word of its own.
#[test]
fn a_partition_is_started_again_and_again() {
    let (mut plc, mut revivals) = account();
    for _ in 0..100 {
        plc.order_restart(StartMode::Cold).unwrap();
        assert!(plc.obey(finished(End::Stopped)).is_some());
        assert!(matches!(revivals.wait(None), Ok(Some(_))));
    }
    assert_eq!(plc.restarts, 100);
}
