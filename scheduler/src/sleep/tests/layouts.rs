//! A first step of the clock's rate beside all threads of a CPU, in layouts of windows that are chosen at random.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;

use super::simulated_cpu::{ENFORCER, LOOK, OnCpu, SIGNAL, SimulatedCpu, State, WAKE};
use super::*;
use crate::quiet::QuietTimes;
use crate::reservation::{CpuReservations, Reservation};
use crate::schedules::{ScheduleId, Schedules};
use crate::switch::ScheduleState;
use crate::table::{Cpu, PartitionId, Placement, Role, Window};
use crate::time::Timebase;
use crate::timetable::{Release, Slot};

const BASE: Timebase = Timebase { epoch: Tsc(0), frequency: FREQUENCY };
/// Frames of a run, and those of them in which sleepers come to trust the clock.
const FRAMES: u64 = 16;
const SETTLED: u64 = 4;
/// Layouts that are tried. 8,000 were, once.
const CASES: u64 = 400;
/// Partitions on one CPU, with times in us.
#[derive(Clone, Debug)]
struct Layout {
    frame: u64,
    guards: Vec<u64>,
    /// Owner, start and end of each window, by schedule.
    tables: Vec<Vec<(usize, u64, u64)>>,
    /// Of its window each takes so many thousandths; more than all for one that must be kicked.
    takes: Vec<u64>,
    /// A partition whose thread has ended.
    gone: Option<usize>,
}

impl Layout {
    /// Of two to four partitions with some windows each, many as close as they may be. Such as `takt check` lets pass.
    fn random(seed: &mut u64) -> (Layout, Arc<Schedules>) {
        loop {
            let frame = [1_000, 1_000, 2_000, 4_000, 10_000][below(seed, 5) as usize];
            let count = 2 + below(seed, 3);
            let guards: Vec<u64> = (0..count)
                .map(|_| [20, 20, 20, 25, 40, 60, 200][below(seed, 7) as usize])
                .collect();
            let takes = (0..count).map(|_| below(seed, 1_400)).collect();
            let gone = Some(below(seed, 3 * count) as usize).filter(|gone| *gone < guards.len());
            let tables = 1 + below(seed, 2);
            let tables = (0..tables).map(|_| table(seed, frame, &guards)).collect();
            let layout = Layout { frame, guards, tables, takes, gone };
            if let Some(schedules) = layout.schedules() {
                return (layout, Arc::new(schedules));
            }
        }
    }

    fn schedules(&self) -> Option<Schedules> {
        let us = Nanos::from_micros;
        let role = |guard: &u64| Role::Windowed { guard: us(*guard) };
        let placements: Vec<Placement> =
            self.guards.iter().map(|guard| Placement { cpu: Cpu(0), role: role(guard) }).collect();
        let window = |(partition, from, to): &(usize, u64, u64)| Window {
            partition: PartitionId(*partition),
            offset: us(*from),
            duration: us(to - from),
            period: us(self.frame),
        };
        let tables: Vec<Vec<Window>> =
            self.tables.iter().map(|table| table.iter().map(window).collect()).collect();
        let tables: Vec<&[Window]> = tables.iter().map(Vec::as_slice).collect();
        let schedules = Schedules::new(us(self.frame), &placements, &tables).ok()?;
        CpuReservations::check(&schedules, Cpu(0)).ok()?;
        CpuReservations::of(&schedules, Cpu(0)).has_room_for_looks().then_some(schedules)
    }
}

/// Windows of one schedule: first one of each partition, then of any.
fn table(seed: &mut u64, frame: u64, guards: &[u64]) -> Vec<(usize, u64, u64)> {
    let count = guards.len() as u64;
    let mut at = below(seed, 260);
    let mut table: Vec<(usize, u64, u64)> = Vec::new();
    for number in 0..count + below(seed, 4) {
        let owner = if number < count { number } else { below(seed, count) } as usize;
        let follows_itself = table.last().is_some_and(|(before, ..)| *before == owner);
        at += guards[owner] + if follows_itself { 0 } else { 30 };
        at += below(seed, 2) * below(seed, 2) * below(seed, frame / 3);
        let most = [60, 400, frame * 7 / 5 / count][below(seed, 3) as usize];
        let length = 10 + below(seed, most);
        if at + length > frame {
            break;
        }
        table.push((owner, at, at + length));
        at += length;
    }
    table
}

/// What was seen behind the first frames.
#[derive(Debug, Default)]
struct Seen {
    /// Partitions and how late their releases were, in ns.
    late: Vec<(usize, u64)>,
    lost: u64,
    latest_kick: u64,
    /// The same of windows that must end in time.
    latest_in_time: u64,
    /// When the window enforcer woke, and how long it was up.
    work: Vec<(u64, u64)>,
}

/// What all threads of a run share.
struct Run {
    layout: Layout,
    schedules: Arc<Schedules>,
    cpu: Arc<SimulatedCpu>,
    board: Arc<ScheduleState>,
    quiet: QuietTimes,
    reservations: CpuReservations,
    wake_ups: Vec<WakeUps>,
    seen: Mutex<Seen>,
}

impl Run {
    /// Under these rates, with a switch of schedules if there are two.
    fn of(layout: &Layout, schedules: &Arc<Schedules>, rates: &[(u64, i64)]) -> Seen {
        let threads = 1 + layout.guards.len();
        let run = Arc::new(Run {
            layout: layout.clone(),
            schedules: schedules.clone(),
            cpu: SimulatedCpu::new(rates, threads),
            board: Arc::new(ScheduleState::new(schedules.frame(), schedules.tables().len())),
            quiet: schedules.quiet_on(Cpu(0), None).unwrap(),
            reservations: CpuReservations::of(schedules, Cpu(0))
                .by_a_clock_whose_steering_is(Steering::Possible),
            wake_ups: (0..threads).map(|_| WakeUps::default()).collect(),
            seen: Mutex::default(),
        });
        let spawn = |me: usize| {
            let run = run.clone();
            thread::spawn(move || {
                run.cpu.begin(me);
                match me.checked_sub(1) {
                    None => run.enforcer(),
                    Some(own) if run.layout.gone == Some(own) => {}
                    Some(own) => run.partition(own),
                }
                run.cpu.give_up(me, State::Gone);
            })
        };
        let threads: Vec<_> = (0..threads).map(spawn).collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        std::mem::take(&mut *run.seen.lock().unwrap())
    }

    fn rest(&self) -> Rest {
        Rest::new(self.quiet.clone(), self.board.clone(), BASE)
    }

    fn is_over(&self, instant: Nanos) -> bool {
        instant.0 > FRAMES * self.layout.frame * 1_000
    }

    /// As `vcpu/windowed.rs` of the VMM has it.
    fn partition(self: &Arc<Self>, own: usize) {
        let id = PartitionId(own);
        let reservation = self.reservations.partitions.iter().find(|(it, _)| *it == id).unwrap().1;
        let run = self.clone();
        let rest = self.rest().reserved(&reservation).on_steered(Box::new(move || {
            if !run.wake_ups[ENFORCER].distrusting() {
                run.cpu.tell(ENFORCER);
            }
        }));
        let mut sleeper = Sleeper::new(FREQUENCY).resting(rest);
        let mut machine = OnCpu(self.cpu.clone(), 1 + own, Vec::new());
        let timetable = self.schedules.timetable_of(id).unwrap();
        let guard = Nanos::from_micros(self.layout.guards[own]);
        let mut slot = timetable.first(self.board.switch());
        loop {
            let due = match slot {
                Slot::Window(release) => release.start.less(guard),
                Slot::Idle(idle) => idle.start,
            };
            if self.is_over(due) {
                return;
            }
            let wake_ups = &self.wake_ups[1 + own];
            while sleeper.sleep(&mut machine, BASE.instant(due), wake_ups) == Woken::BySignal {}
            let now = Nanos(self.cpu.now());
            let next = match slot {
                Slot::Window(release) if now < release.end => {
                    let next = timetable.after(&slot, self.board.switch());
                    self.window(own, &release, now);
                    next
                }
                _ => {
                    self.seen.lock().unwrap().lost += u64::from(self.counts(&slot));
                    timetable.catch_up(&slot, now, self.board.switch())
                }
            };
            slot = next;
        }
    }

    fn counts(&self, slot: &Slot) -> bool {
        matches!(slot, Slot::Window(release) if release.frame >= SETTLED)
    }

    fn window(&self, own: usize, release: &Release, now: Nanos) {
        let ready = now.plus(Nanos(WAKE));
        if release.frame >= SETTLED && ready > release.start {
            self.seen.lock().unwrap().late.push((own, ready.less(release.start).0));
        }
        let length = release.end.less(release.start).0;
        let takes = match self.layout.takes[own] {
            part if part < 1_000 => (length * part / 1_000).max(100),
            _ => 1_000 * length,
        };
        let until = now.max(release.start).0 + takes;
        self.cpu.run_window(1 + own, release.end.0, until);
    }

    /// As `vcpu/window_enforcer.rs` has it.
    fn enforcer(self: &Arc<Self>) {
        let timetable = self.schedules.timetable_on(Cpu(0)).unwrap();
        let must_end_in_time = self.schedules.must_end_in_time_on(Cpu(0));
        let windows =
            |table: &crate::table::Table| table.windows_on(Cpu(0)).map(|w| w.partition.0).collect();
        let owners: Vec<Vec<usize>> = self.schedules.tables().iter().map(windows).collect();
        let owner = |slot: &Slot| match slot {
            Slot::Window(release) => owners[release.schedule.0][release.window],
            Slot::Idle(_) => usize::MAX,
        };
        let next: Arc<[AtomicUsize; 2]> = Arc::default();
        let signals = Arc::new(AtomicU64::new(0));
        let rest = self.rest().on_steered(Box::new({
            let (run, next, signals) = (self.clone(), next.clone(), signals.clone());
            move || {
                for owner in next.iter().map(|owner| owner.load(Ordering::Relaxed)) {
                    let Some(wake_ups) =
                        run.wake_ups.get(owner.wrapping_add(1)).filter(|_| owner != usize::MAX)
                    else {
                        continue;
                    };
                    if !wake_ups.distrusting() && run.cpu.tell(1 + owner) {
                        signals.fetch_add(1, Ordering::Relaxed);
                        run.cpu.work(SIGNAL);
                    }
                }
            }
        }));
        let mut sleeper = Sleeper::new(FREQUENCY).lazy().resting(rest);
        let mut machine = OnCpu(self.cpu.clone(), ENFORCER, Vec::new());
        let mut slot = timetable.first(self.board.switch());
        loop {
            let after = timetable.after(&slot, self.board.switch());
            for (next, slot) in next.iter().zip([&slot, &after]) {
                next.store(owner(slot), Ordering::Relaxed);
            }
            let (end, window) = match slot {
                Slot::Window(release) => (release.end, Some(release)),
                Slot::Idle(idle) => (idle.start, None),
            };
            if self.is_over(end) {
                break;
            }
            let wake_ups = &self.wake_ups[ENFORCER];
            let instant = BASE.instant(end);
            while Woken::BySignal
                == match window {
                    Some(release) => sleeper.sleep_to_end(
                        &mut machine,
                        (BASE.instant(release.start), instant),
                        must_end_in_time[release.schedule.0][release.window],
                        wake_ups,
                    ),
                    None => sleeper.sleep(&mut machine, instant, wake_ups),
                }
            {}
            let now = Nanos(self.cpu.now());
            if let Some(release) = window {
                let mut seen = self.seen.lock().unwrap();
                if self.counts(&slot) {
                    let late = now.less(end).0;
                    seen.latest_kick = seen.latest_kick.max(late);
                    if must_end_in_time[release.schedule.0][release.window] {
                        seen.latest_in_time = seen.latest_in_time.max(late);
                    }
                }
                let up = machine.2.drain(..);
                seen.work.extend(up.map(|woken| (woken, LOOK)));
                if let Some((_, took)) = seen.work.last_mut() {
                    // Its end takes 9 us.
                    *took += 2_000 + SIGNAL * signals.swap(0, Ordering::Relaxed);
                }
                drop(seen);
                self.cpu.end_window(1 + owners[release.schedule.0][release.window]);
            }
            if self.layout.tables.len() > 1 && now.0 > 6 * self.layout.frame * 1_000 {
                let _ = self.board.request(ScheduleId(1), now);
            }
            self.board.adopt(|| now);
            let next = timetable.after(&slot, self.board.switch());
            let over = match next {
                Slot::Window(release) => release.end,
                Slot::Idle(idle) => idle.start,
            };
            slot = if over > now {
                next
            } else {
                (0..self.layout.guards.len()).for_each(|owner| self.cpu.end_window(1 + owner));
                timetable.catch_up(&slot, now, self.board.switch())
            };
        }
        // Windows that still run are left to their programs.
        (0..self.layout.guards.len()).for_each(|owner| self.cpu.end_window(1 + owner));
    }
}

/// How long a thread with this reservation that works so would have to wait at most for its next budget when it wakes
/// (`update_dl_entity` in kernel/sched/deadline.c).
fn longest_throttle(work: &[(u64, u64)], Reservation { runtime, period }: Reservation) -> u64 {
    let (runtime, period) = (runtime.0 as i64, period.0);
    let (mut left, mut deadline, mut longest) = (runtime, 0_u64, 0);
    for (woken, took) in work {
        let keeps = |until: u64| {
            i128::from(left) * i128::from(period) <= i128::from(runtime) * i128::from(until)
        };
        match deadline.checked_sub(*woken) {
            Some(until) if until > 0 && left <= 0 => {
                longest = longest.max(until);
                (left, deadline) = (runtime, deadline + period);
            }
            Some(until) if until > 0 && keeps(until) => {}
            _ => (left, deadline) = (runtime, woken + period),
        }
        left -= *took as i64;
    }
    longest
}

/// What a step of the rate may do. False if releases are late without it: a program that must be kicked can be in the way
/// of one of its own partition that follows at once.
fn try_step(
    (layout, schedules): &(Layout, Arc<Schedules>),
    rates: &[(u64, i64)],
    latest_kick: &mut u64,
) -> bool {
    let before = Run::of(layout, schedules, &rates[..rates.len() - 1]);
    if !before.late.is_empty() || before.lost > 0 {
        return false;
    }
    let Seen { late, lost, latest_kick: kick, latest_in_time, work } =
        Run::of(layout, schedules, rates);
    let context = format!("{rates:?} in {layout:?}");
    assert!(late.is_empty() && lost == 0, "{late:?}, {lost} lost, {context}");
    // Under a clock that it does not trust the window enforcer looks once.
    let most = if rates.len() == 2 { 21_500 } else { 28_500 };
    assert!(latest_in_time <= most, "ended {latest_in_time} ns late, {context}");
    let reservations = CpuReservations::of(schedules, Cpu(0));
    let reservations = reservations.by_a_clock_whose_steering_is(Steering::Possible);
    let throttled = longest_throttle(&work, reservations.kicker.unwrap());
    assert!(throttled <= SURE.0 / 9, "{throttled} ns without budget, {context}");
    *latest_kick = kick.max(*latest_kick);
    true
}

#[test]
fn a_first_step_makes_no_release_late_in_any_layout() {
    let (mut seed, mut tried, mut latest) = (11, 0, 0);
    for _ in 0..CASES {
        let found = Layout::random(&mut seed);
        let frame = found.0.frame * 1_000;
        let step = 8 * frame + below(&mut seed, 3 * frame);
        let steps = [-100_500, -100_000, -50_000, -10_000, 50_000, 100_500];
        let then = steps[below(&mut seed, 6) as usize];
        // In some the clock was once fast, for a moment.
        let again = [(0, 0), (2 * frame, 100_000), (2 * frame + 300_000, 0), (step, then)];
        let rates = if below(&mut seed, 4) == 0 { &again } else { &[(0, 0), (step, then)][..] };
        tried += u64::from(try_step(&found, rates, &mut latest));
    }
    assert!(tried > CASES / 2 && latest > 50_000, "{tried} of {CASES}, {latest} ns");
}

#[test]
fn a_first_step_makes_no_release_late_where_once_it_did() {
    // A long window of a partition without a thread, and one that can be looked at before that window only, or behind it.
    let hole = Layout {
        frame: 2_000,
        guards: vec![20, 60],
        tables: vec![vec![(0, 500, 695), (1, 805, 900)]],
        takes: vec![100, 100],
        gone: Some(0),
    };
    // A program that must be kicked, and a release 50 us behind its window, on a CPU that is nearly full.
    let full = Layout {
        frame: 1_000,
        guards: vec![20, 20],
        tables: vec![vec![(0, 50, 350), (1, 400, 700)]],
        takes: vec![1_100, 500],
        gone: None,
    };
    for layout in [hole, full] {
        let schedules = Arc::new(layout.schedules().unwrap());
        let found = (layout, schedules);
        let frame = found.0.frame * 1_000;
        for step in (8 * frame..9 * frame).step_by(10_000) {
            assert!(try_step(&found, &[(0, 0), (step, -100_000)], &mut 0));
        }
    }
}
