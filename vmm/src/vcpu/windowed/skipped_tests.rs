use std::sync::Arc;

use kvm_ioctls::Kvm;
use takt_devices::output;
use takt_scheduler::guard::ReleaseGuard;
use takt_scheduler::reservation::Reservation;
use takt_scheduler::schedules::{ScheduleId, Schedules};
use takt_scheduler::sleep::Steering;
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};
use takt_scheduler::time::{Nanos, Timebase, TscFrequency};
use takt_scheduler::timetable::Idle;

use super::*;
use crate::boot::StartMode;
use crate::health::{Action, Fault, Table};
use crate::hooks::Hooks;
use crate::memory::{GuestMemory, Pages};
use crate::vcpu::Control;
use crate::vcpu::kick::Kickable;
use crate::vcpu::plc::PlcGuest;
use crate::vcpu::records::{RecordReader, records};
use crate::vcpu::windowed::Plan;

/// Far longer than a test takes, so that no frame ends while it runs.
const FRAME: Nanos = Nanos::from_millis(1_000);
const GUARD: Nanos = Nanos::from_millis(1);

/// A PLC's windows at the start of each frame. In the second schedule they are another's.
fn windowed(frames: u64, table: Table) -> (Windowed, Reporter, RecordReader) {
    let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: GUARD } };
    let window = |partition, ms| Window {
        partition: PartitionId(partition),
        offset: Nanos::from_millis(ms),
        duration: Nanos::from_millis(100),
        period: FRAME,
    };
    let tables: [&[Window]; 2] = [&[window(0, 0), window(1, 500)], &[window(1, 500)]];
    let schedules = Schedules::new(FRAME, &[plc, plc], &tables).unwrap();
    let plan = Plan {
        timetable: schedules.timetable_of(PartitionId(0)).unwrap(),
        board: Arc::new(ScheduleState::new(FRAME, tables.len())),
        guard: ReleaseGuard::Fixed(GUARD),
        quiet: None,
        reservation: Reservation { runtime: GUARD, period: FRAME },
        steering: Steering::Impossible,
        enforcer: Arc::default(),
        late_wake_up: Hooks::default().late_wake_up(),
        deadlines: Box::default(),
        on_switch: None,
    };
    let frequency = TscFrequency::from_khz(4_000_000).unwrap();
    // A window of 100 ms, and half of a second more.
    let passed = Nanos(frames * FRAME.0 + 600_000_000);
    let base = Timebase { epoch: Tsc::now().before(frequency.ticks(passed)), frequency };
    let (producer, records) = records(8);
    let (reporter, ..) = Reporter::new(table);
    (Windowed::new(plan, base, producer), reporter, records)
}

fn lost_counts(action: Action) -> Table {
    Table::PLC.with(Fault::DeadlineMissed, action)
}

/// What is in the ring, which has nothing else in it.
fn skipped(records: &mut RecordReader) -> Option<Skipped> {
    match (records.pop()?, records.pop()) {
        (Record::Skipped(skipped), None) => Some(skipped),
        other => panic!("{other:?}"),
    }
}

const LOST: End = End::Raised(Detail::Lost(11, 10));

#[test]
fn what_a_thread_has_slept_through_is_told_before_it_sleeps_again() {
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(Action::Idle));
    thread.starting = false;
    let (due, woken) = (Tsc(5), Tsc::now());
    assert_eq!(thread.pass(due, woken, &mut health), Some(LOST));
    assert_eq!(skipped(&mut records), Some(Skipped { count: 11, due, woken }));
    // The next window has it for the trace.
    assert_eq!((thread.skipped, thread.slot.sequence()), (11, 11));
}

#[test]
fn a_guest_that_is_starting_misses_no_deadline_and_its_windows_are_told() {
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(Action::Idle));
    assert_eq!(thread.pass(Tsc(5), Tsc::now(), &mut health), None);
    assert_eq!(skipped(&mut records).unwrap().count, 11);
}

#[test]
fn a_stop_tells_of_what_was_slept_through_until_then_and_of_nothing_else() {
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(Action::Log));
    thread.starting = false;
    let (first, control) = (thread.slot, Control::default());
    assert_eq!(thread.leave(first, End::Stopped, &control, &mut health), End::Stopped);
    let Skipped { count, due, woken } = skipped(&mut records).unwrap();
    let epoch = thread.base.epoch;
    assert_eq!((count, health.noted()), (11, 1));
    assert_eq!(due, epoch.before(thread.base.frequency.ticks(GUARD)));
    assert!(woken > thread.base.instant(Nanos(10 * FRAME.0)));
    // It has caught up with the schedule, so nothing is told twice.
    assert_eq!(thread.leave(thread.slot, End::Stopped, &control, &mut health), End::Stopped);
    assert_eq!((skipped(&mut records), health.noted()), (None, 1));
}

#[test]
fn what_passes_after_the_order_to_stop_is_no_lost_release() {
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(Action::Log));
    thread.starting = false;
    let control = Control::default();
    // The order came before the epoch's first window had ended, and is seen ten frames later.
    control.stop.store(thread.base.epoch.0 + 1, std::sync::atomic::Ordering::SeqCst);
    assert_eq!(thread.leave(thread.slot, End::Stopped, &control, &mut health), End::Stopped);
    assert_eq!((skipped(&mut records), health.noted()), (None, 0));
}

#[test]
fn a_thread_without_a_guest_goes_on_to_the_first_window_that_is_to_come_and_stays_there() {
    for frames in [10, 1_000_000_000] {
        let (mut thread, ..) = windowed(0, lost_counts(Action::Log));
        thread.base.epoch = Tsc(1);
        let now = thread.base.instant(Nanos(frames * FRAME.0 + 600_000_000));
        // What has passed takes one step, however long it was.
        thread.go_on(now);
        assert_eq!(thread.slot.sequence(), frames + 1);
        // As if it had been halted while it slept: the window after that is in a frame that must not be planned yet.
        thread.go_on(now);
        assert_eq!(thread.slot.sequence(), frames + 1);
    }
}

#[test]
fn a_frame_without_a_window_is_looked_at_outside_of_the_windows_of_others() {
    let (mut thread, ..) = windowed(0, lost_counts(Action::Log));
    let idle = Idle { sequence: 0, frame: 3, start: Nanos(3 * FRAME.0) };
    assert_eq!(thread.look(&idle), thread.base.instant(idle.start), "there are none");
    let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: GUARD } };
    let look = |ms| {
        let duration = Nanos::from_millis(ms);
        let (partition, offset) = (PartitionId(0), Nanos::ZERO);
        let window = Window { partition, offset, duration, period: FRAME };
        let schedules = Schedules::new(FRAME, &[plc], &[&[window]]).unwrap();
        thread.plan.quiet = schedules.quiet_on(Cpu(0), None);
        thread.base.offset(thread.look(&idle)).less(idle.start)
    };
    let [short, long] = [100, 600].map(look);
    assert!(short > Nanos::from_millis(100) && short < Nanos::from_millis(101), "{short}");
    assert_eq!(long, Nanos::ZERO, "too late for what the next frame may have");
}

#[test]
fn windows_after_frames_without_any_are_told_too() {
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(Action::Log));
    thread.starting = false;
    let control = Control::default();
    let board = thread.plan.board.clone();
    let at = |frame: u64| Nanos(frame * FRAME.0);
    // Without windows from frame 2 on, with them again from frame 6 on.
    for (schedule, frame) in [(1, 0), (0, 4)] {
        board.request(ScheduleId(schedule), at(frame)).unwrap();
        assert!(board.adopt(|| at(frame)));
        thread.switch = board.switch();
        if schedule == 1 {
            thread.slot = thread.plan.timetable.catch_up(&thread.slot, at(3), thread.switch);
        }
    }
    assert!(matches!(thread.slot, Slot::Idle(idle) if (idle.frame, idle.sequence) == (3, 2)));
    assert_eq!(thread.leave(thread.slot, End::Stopped, &control, &mut health), End::Stopped);
    // Those of the frames 6 to 10.
    assert_eq!((skipped(&mut records).unwrap().count, thread.slot.sequence()), (5, 7));
    assert_eq!(health.noted(), 1);
}

/// Runs a PLC whose thread comes more than ten frames late; `None` without KVM.
fn run(action: Action, on_switch: Option<StartMode>, stop: bool) -> Option<(End, Skipped)> {
    let Ok(kvm) = Kvm::new() else {
        eprintln!("skipped: no /dev/kvm");
        return None;
    };
    let vm = kvm.create_vm().unwrap();
    let mut kickable = Kickable::new(vm.create_vcpu(0).unwrap());
    let memory = GuestMemory::for_plc(2 << 20, Pages::Small, &[]).unwrap();
    let (console, _end) = output::dropping();
    let mut guest = PlcGuest::new(&memory, 2 << 20, 1_000_000, FRAME, console).unwrap();
    let (mut thread, mut health, mut records) = windowed(10, lost_counts(action));
    thread.starting = false;
    if on_switch.is_some() {
        thread.plan.on_switch = on_switch;
        thread.acted = 1;
    }
    let control = Arc::new(Control::default());
    if stop {
        Control::stop_all(std::slice::from_ref(&control));
    }
    let end = thread.run(&mut kickable, &mut guest, &control, &mut health);
    Some((end, skipped(&mut records).unwrap()))
}

#[test]
fn no_end_of_a_run_drops_what_was_slept_through() {
    for (action, on_switch, stop, expected) in [
        (Action::Log, None, true, End::Stopped),
        (Action::Idle, None, true, LOST),
        (Action::Log, Some(StartMode::Warm), false, End::ScheduleChange(StartMode::Warm)),
        (Action::Idle, Some(StartMode::Warm), false, LOST),
        // It has only come too late.
        (Action::Idle, None, false, LOST),
    ] {
        let Some((end, skipped)) = run(action, on_switch, stop) else { return };
        assert_eq!((end, skipped.count), (expected, 11), "{action} {on_switch:?} {stop}");
    }
}
