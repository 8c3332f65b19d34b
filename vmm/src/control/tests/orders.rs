//! Orders to a partition whose thread is this one.

use takt_devices::output;
use takt_devices::watchdog::Timer;
use takt_scheduler::schedules::{ScheduleId, Schedules};
use takt_scheduler::switch::Switch;
use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};
use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};
use vmm_sys_util::eventfd::EventFd;

use super::super::Outcome;
use super::super::protocol::{ErrorKind, EventKind, State};
use crate::account::Account;
use crate::boot::StartMode;
use crate::boot::plc::{PlcImage, Source};
use crate::delay::Delay;
use crate::handoff::handoff;
use crate::health::{Table, Watch};
use crate::life::{Event, Finished, Life, Order};
use crate::memory::{GuestMemory, Pages};
use crate::passthrough::safe_values::SafeValues;
use crate::power_button::PowerButton;
use crate::restart::{PlcLoader, Restart, Revivals};
use crate::terminal::Lines;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::guest::End;
use crate::vcpu::plc::PlcGuest;
use crate::vcpu::records::records;
use takt_record::{Record, Skipped, WindowAssembler};

const RAM: u64 = 4 << 20;

fn account() -> (Account, Revivals<PlcGuest>) {
    let memory = GuestMemory::for_plc(RAM, Pages::Small, &[]).unwrap();
    let image = PlcImage::read(Source::Demo, RAM).unwrap();
    let processor = FirstState::none();
    let (channels, safe_values) = (Vec::new(), SafeValues::default());
    let programs = None;
    let loader = PlcLoader {
        memory,
        image,
        programs,
        channels,
        space: None,
        safe_values,
        processor,
        apic_keys: None,
    };
    let spawn = |_: &str, _, work: Box<dyn FnOnce() + Send>| {
        std::thread::spawn(work);
        Ok(())
    };
    let (restart, revivals) = Restart::new(loader, &spawn).unwrap();
    let (_, output) = output::dropping();
    let account = Account {
        name: "plc".into(),
        control: std::sync::Arc::default(),
        further: Vec::new(),
        output,
        unshown: 0,
        is_terminal: false,
        is_shown: true,
        log: None,
        keyboard: None,
        records: None,
        attendance: None,
        assembler: WindowAssembler::default(),
        says_done: true,
        health: Watch::new(Table::PLC).0,
        releases: None,
        samples: None,
        load: None,
        occupied: Nanos::ZERO,
        watchdog: None,
        leaves_by: Nanos::ZERO,
        looked: 0,
        timetable: None,
        kernel: None,
        disks: Vec::new(),
        links: Vec::new(),
        deadlines: Vec::new(),
        banks: None,
        power_button: None,
        life: Life::new(restart.starts()),
        restart: Some(restart),
        ends: handoff(1).1,
        delay: Delay::default(),
        lines: Lines::default(),
    };
    (account, revivals)
}

/// The thread tells of an end; what came of an order, if there was one.
fn left(plc: &mut Account, end: End) -> Option<Outcome> {
    let (at, cpu_time) = (Tsc(0), Nanos(5));
    let finished = Finished { end, at, starting: false, noted: 0, cpu_time };
    let effects = plc.step(Event::Left { finished, action: None, leaving: false });
    effects.told.and_then(|told| plc.outcome(told))
}

#[test]
fn a_partition_stops_when_its_thread_says_so_and_can_be_started() {
    let (mut plc, mut revivals) = account();
    assert_eq!(plc.operate(Order::Start(StartMode::Cold)).unwrap_err().error, ErrorKind::Refused);
    plc.operate(Order::Stop).unwrap();
    assert!(plc.control.stopping());
    assert_eq!(plc.life.state(), State::Stopping);
    assert_eq!(plc.operate(Order::Stop).unwrap_err().error, ErrorKind::Refused);
    assert!(plc.operate(Order::Restart(StartMode::Cold)).is_err(), "one order at a time");

    let outcome = left(&mut plc, End::Stopped).unwrap();
    assert_eq!(
        (outcome.kind, outcome.text.as_str()),
        (EventKind::Stopped, "stopped by an operator")
    );
    assert_eq!(plc.life.state(), State::Stopped);
    assert_eq!(plc.end().unwrap(), "stopped by an operator");
    assert_eq!(plc.cpu_time(), Nanos(5));
    assert!(revivals.take().unwrap().is_none());

    let outcome = plc.operate(Order::Start(StartMode::Warm)).unwrap().unwrap();
    assert_eq!(outcome.text, "warm start by an operator");
    assert!(revivals.wait(None).is_ok());
    assert!(!plc.control.stopping(), "its thread would stop at once");
    assert_eq!((plc.life.state(), plc.life.restarts(), plc.end()), (State::Running, 1, None));
    assert_eq!(plc.life.start_mode(), StartMode::Warm);
}

#[test]
fn a_partition_that_runs_until_the_end_ends_as_the_readers_of_a_report_know_it() {
    let (mut plc, _) = account();
    plc.step(Event::RunOver);
    left(&mut plc, End::Stopped);
    assert_eq!(plc.end().as_deref(), Some(takt_figures::report::STOPPED));
}

#[test]
fn a_restart_comes_after_the_stop() {
    let (mut plc, mut revivals) = account();
    assert_eq!(plc.operate(Order::Restart(StartMode::Cold)), Ok(None));
    assert_eq!(plc.life.state(), State::Restarting);
    assert!(revivals.take().unwrap().is_none());
    let outcome = left(&mut plc, End::Stopped).unwrap();
    assert_eq!(
        (outcome.kind, outcome.text.as_str()),
        (EventKind::Restarted, "cold start by an operator")
    );
    assert!(revivals.wait(None).is_ok());
    assert!(!plc.control.stopping(), "its thread would stop at once");
    assert_eq!(plc.life.state(), State::Running);
    assert_eq!(left(&mut plc, End::Stopped), None, "an order is carried out once");
}

#[test]
fn an_end_of_its_own_is_told_though_an_order_came_at_the_same_time() {
    let (mut plc, _revivals) = account();
    plc.operate(Order::Stop).unwrap();
    let outcome = left(&mut plc, End::TripleFault).unwrap();
    assert_eq!(outcome.text, "triple fault; stopped by an operator");
    assert_eq!(plc.end().unwrap(), "triple fault");
}

#[test]
fn what_has_ended_by_itself_can_be_started() {
    let (mut plc, mut revivals) = account();
    assert_eq!(left(&mut plc, End::Exited(3)), None);
    assert_eq!(plc.life.state(), State::Ended);
    assert!(plc.operate(Order::Restart(StartMode::Cold)).unwrap().is_some());
    assert!(revivals.wait(None).is_ok());
    assert_eq!(plc.life.state(), State::Running);
}

#[test]
fn a_thread_that_is_gone_starts_nothing() {
    let (mut plc, _revivals) = account();
    assert_eq!(left(&mut plc, End::NotLoaded), None);
    let refusal = plc.operate(Order::Start(StartMode::Cold)).unwrap_err();
    assert!(refusal.text.contains("gone"), "{}", refusal.text);
    assert_eq!(plc.life.state(), State::Ended);
}

#[test]
fn at_the_end_of_the_run_orders_are_forgotten() {
    let (mut plc, _revivals) = account();
    plc.operate(Order::Restart(StartMode::Cold)).unwrap();
    plc.step(Event::RunOver);
    assert_eq!(left(&mut plc, End::Stopped), None);
}

/// More starts than any block of a channel holds, each with a word of its own.
#[test]
fn a_partition_is_started_again_and_again() {
    let (mut plc, mut revivals) = account();
    for _ in 0..100 {
        plc.operate(Order::Restart(StartMode::Cold)).unwrap();
        assert!(left(&mut plc, End::Stopped).is_some());
        assert!(matches!(revivals.wait(None), Ok(Some(_))));
    }
    assert_eq!(plc.life.restarts(), 100);
}

#[test]
fn a_partition_that_does_not_come_to_what_follows_is_told_of() {
    let (mut plc, mut revivals) = account();
    let told = |plc: &mut Account, ms| plc.look_for_delay(Nanos::from_millis(ms)).unwrap_or("");
    plc.control.enter_guest();
    assert_eq!((told(&mut plc, 0), told(&mut plc, 5_000)), ("", ""), "it runs");

    plc.operate(Order::Restart(StartMode::Cold)).unwrap();
    assert_eq!((told(&mut plc, 5_020), told(&mut plc, 6_000)), ("", ""));
    assert!(told(&mut plc, 6_020).starts_with("it does not leave its processor"));
    assert_eq!(told(&mut plc, 9_000), "");

    plc.control.leave_guest();
    left(&mut plc, End::Stopped).unwrap();
    assert!(revivals.wait(None).is_ok());
    assert_eq!(told(&mut plc, 9_020), "");
    assert!(told(&mut plc, 10_020).starts_with("it does not run yet"));
    plc.control.enter_guest();
    assert_eq!((told(&mut plc, 10_040), told(&mut plc, 20_000)), ("", ""));

    // A further processor that is kept, and a watchdog that has expired.
    let other = std::sync::Arc::<crate::vcpu::Control>::default();
    plc.further = vec![other.clone()];
    other.halt();
    assert_eq!(told(&mut plc, 20_020), "");
    assert!(told(&mut plc, 21_020).starts_with("it does not leave its processor"));
    other.halted();
    assert_eq!(told(&mut plc, 21_040), "");
    let timer = Timer::new(1);
    timer.start(0);
    assert!(timer.expires(u64::MAX - 1));
    plc.watchdog = Some(timer);
    assert_eq!(told(&mut plc, 21_060), "");
    assert!(told(&mut plc, 22_060).starts_with("it does not leave its processor"));

    plc.control.leave_guest();
    left(&mut plc, End::Stopped);
    assert_eq!((told(&mut plc, 22_080), told(&mut plc, 30_000)), ("", ""), "it has ended");
}

/// The Linux has 10 ms of each 4 s in the first of two schedules, and none in the second.
#[test]
fn a_watchdog_waits_for_a_linux_without_windows_and_a_late_window_is_not_the_hosts_fault() {
    const MS: u64 = 1_000_000;
    let ms = Nanos::from_millis;
    let place = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos(20_000) } };
    let window = |id, at| Window {
        partition: PartitionId(id),
        offset: ms(at),
        duration: ms(10),
        period: ms(4_000),
    };
    let tables: [&[Window]; 2] = [&[window(0, 90), window(1, 5)], &[window(1, 5)]];
    let schedules = Schedules::new(ms(4_000), &[place, place], &tables).unwrap();
    let stays = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };
    let leaves = Switch { before: ScheduleId(0), after: ScheduleId(1), frame: 1 };
    let comes = Switch { before: ScheduleId(1), after: ScheduleId(0), frame: 10 };

    let (mut linux, _revivals) = account();
    linux.timetable = schedules.timetable_of(PartitionId(0));
    let timer = Timer::new(500);
    timer.start(0);
    linux.watchdog = Some(timer.clone());
    linux.control.enter_guest();
    let told = |linux: &mut Account, switch, at| {
        linux.look_for_silence(at * MS, switch, ms(at));
        linux.look_for_delay(ms(at)).unwrap_or("")
    };
    for at in (0..40_000).step_by(20) {
        assert_eq!(told(&mut linux, leaves, at), "");
    }
    assert!(!timer.has_expired(), "it has no windows");
    // 5 s after it has windows again the time is up, and its next window is over at 48.1 s.
    for at in (40_000..49_100).step_by(20) {
        assert_eq!((told(&mut linux, comes, at), timer.has_expired()), ("", at >= 44_980), "{at}");
    }
    assert!(told(&mut linux, comes, 49_100).starts_with("it does not leave its processor"));

    // In the background it has to leave at once.
    linux.timetable = None;
    timer.start(50_000 * MS);
    for at in (49_120..56_000).step_by(20) {
        assert_eq!((told(&mut linux, stays, at), timer.has_expired()), ("", at >= 55_000), "{at}");
    }
    assert!(told(&mut linux, stays, 56_000).starts_with("it does not leave its processor"));
}

#[test]
fn a_linux_is_not_silent_while_takt_itself_is_stopped() {
    const MS: u64 = 1_000_000;
    let stays = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };
    let (mut linux, _revivals) = account();
    let timer = Timer::new(500);
    linux.watchdog = Some(timer.clone());
    linux.looked = 10_000 * MS;
    timer.start(10_000 * MS);
    let mut look = |at| {
        linux.look_for_silence(at * MS, stays, Nanos::from_millis(at));
        timer.has_expired()
    };
    // Stopped once for less than its time and once for more.
    for (from, until) in [(10_000, 14_000), (18_000, 20_000), (60_000, 65_000)] {
        for at in (from..until).step_by(20) {
            assert!(!look(at), "{at}");
        }
    }
    // A silence in which Takt runs is one.
    assert!(look(65_000));
}

/// A Linux with a power button, and the other end of its wire.
fn linux_with_a_button() -> (Account, std::sync::Arc<EventFd>, Revivals<PlcGuest>) {
    let (mut linux, revivals) = account();
    let wire = std::sync::Arc::new(crate::event::eventfd().unwrap());
    linux.power_button = Some(PowerButton::new(wire.clone(), Nanos(7)));
    (linux, wire, revivals)
}

#[test]
fn a_linux_that_runs_at_the_end_is_asked_to_power_off_and_is_not_started_again() {
    let (mut linux, wire, mut revivals) = linux_with_a_button();
    linux.control.enter_guest();
    assert_eq!(linux.ask_to_power_off(Nanos(1)), Some((Some(Nanos(7)), "asked to power off")));
    assert!(wire.read().is_ok() && !linux.control.stopping());
    let refusal = linux.operate(Order::Restart(StartMode::Cold)).unwrap_err();
    assert_eq!(refusal.text, "plc: it is not started any more, since the run ends");
    linux.control.leave_guest();
    left(&mut linux, End::PoweredOff);
    assert!(linux.operate(Order::Start(StartMode::Cold)).is_err());
    assert_eq!(linux.ask_to_power_off(Nanos(2)), None, "it is off");
    assert!(revivals.take().unwrap().is_none());
}

#[test]
fn a_linux_that_is_being_started_at_the_end_does_not_begin() {
    let (mut linux, wire, _revivals) = linux_with_a_button();
    assert_eq!(
        linux.ask_to_power_off(Nanos(1)),
        Some((None, "not started again, since the run ends"))
    );
    assert!(wire.read().is_err(), "there is nothing to ask");
    assert!(linux.control.stopping());
    left(&mut linux, End::Stopped);
    assert_eq!(linux.end().as_deref(), Some(takt_figures::report::STOPPED));
    assert!(linux.power_button.unwrap().report(None).is_none());
}

#[test]
fn a_restart_that_was_ordered_before_the_end_does_not_follow() {
    let (mut linux, _wire, mut revivals) = linux_with_a_button();
    linux.control.enter_guest();
    linux.operate(Order::Restart(StartMode::Cold)).unwrap();
    assert!(linux.ask_to_power_off(Nanos(1)).is_some());
    assert_eq!(left(&mut linux, End::Stopped), None);
    assert_eq!((linux.life.state(), linux.life.restarts()), (State::Ended, 0));
    assert!(revivals.take().unwrap().is_none());
}

#[test]
fn figures_say_how_many_windows_they_lack() {
    let (mut plc, _revivals) = account();
    let (mut writer, reader) = records(1);
    plc.records = Some(reader);
    assert!(plc.figures().is_none(), "before the epoch");
    let frequency = TscFrequency::from_khz(1_000_000).unwrap();
    plc.start(Timebase { epoch: Tsc(0), frequency }, false);
    let record = Record::Skipped(Skipped { count: 5, due: Tsc(0), woken: Tsc(0) });
    (0..3).for_each(|_| writer.push(record));
    assert_eq!(plc.figures().unwrap().unrecorded, 10);
}

#[test]
fn a_load_ends_when_its_linux_is_asked_to_power_off() {
    let (mut linux, _wire, _revivals) = linux_with_a_button();
    linux.is_terminal = true;
    let frequency = TscFrequency::from_khz(1_000_000).unwrap();
    linux.start(Timebase { epoch: Tsc(0), frequency }, true);
    linux.load.as_mut().unwrap().add(b"takt-load: cpu 0 MiB\n", Nanos(10));
    linux.control.enter_guest();
    linux.ask_to_power_off(Nanos(15)).unwrap();
    linux.load.as_mut().unwrap().add(b"takt-load: cpu 1 MiB\n", Nanos(20));
    let course = linux.load_course(Nanos(99)).unwrap();
    assert_eq!((course.points, course.standstill.to_ns), (vec![(10, 0)], 15));
}

#[test]
fn a_linux_keeps_from_others_what_it_uses_of_its_windows() {
    let (mut linux, _revivals) = account();
    linux.records = Some(records(1).1);
    linux.occupied = Nanos(900);
    left(&mut linux, End::PoweredOff);
    assert_eq!(linux.used(), Nanos(900), "a PLC");
    linux.says_done = false;
    assert_eq!(linux.used(), Nanos(5), "its thread's CPU time");
    // In the background it has no windows.
    (linux.records, linux.occupied) = (None, Nanos::ZERO);
    assert_eq!(linux.used(), Nanos::ZERO);
}
