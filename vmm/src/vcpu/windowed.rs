//! Running a partition in its windows.
//!
//! Release `n` lies at a fixed place on the TSC, computed from its frame alone: nothing that
//! happens in one window can move the next. The thread wakes a guard time early and enters the
//! guest, which itself waits for the exact instant; the latency of the wake-up disappears in that
//! wait.

mod skipped;

use std::sync::Arc;

use kvm_ioctls::{VcpuExit, VcpuFd};
use takt_scheduler::guard::ReleaseGuard;
use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::reservation::Reservation;
use takt_scheduler::rest::Rest;
use takt_scheduler::sleep::{Sleeper, Steering, Woken};
use takt_scheduler::switch::{ScheduleState, Switch};
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Idle, Slot, Timetable};

use super::Control;
use super::first_scan::FirstScan;
use super::guest::{End, Guest, KvmFailure, Step};
use super::guest_counter::GuestCounter;
use super::guest_timer::{self, Deadlines};
use super::kick::Kickable;
use super::port_access::PortAccess;
use super::record::{DETOURS_MAX, Detour, Exit, Record, WindowRecord};
use super::records::RecordWriter;
use super::tick::Tick;
use crate::boot::StartMode;
use crate::health::{Access, Answer, Detail, Reporter};
use crate::hooks::LateWakeUp;

/// When a partition runs.
pub struct Plan {
    /// Its windows.
    pub timetable: Timetable,
    /// Which schedule holds.
    pub board: Arc<ScheduleState>,
    /// How long before a window the thread wakes.
    pub guard: ReleaseGuard,
    /// The quiet times of its CPU, in which it does not wake between the pieces of a sleep.
    pub quiet: Option<QuietTimes>,
    /// What its thread has reserved of the processor.
    pub reservation: Reservation,
    /// Whether the clock of its sleeps may be steered.
    pub steering: Steering,
    /// Who ends the windows of its CPU, to be told of a steered clock.
    pub enforcer: Arc<Control>,
    /// Which wake-up a test wants late.
    pub late_wake_up: LateWakeUp,
    /// The deadlines of other Linuxes, which wait for this partition's windows.
    pub deadlines: Box<[Arc<Deadlines>]>,
    /// How the partition is started anew when a switch takes effect; `None`: it goes on.
    pub on_switch: Option<StartMode>,
}

/// A partition on its way from window to window.
pub struct Windowed {
    plan: Plan,
    base: Timebase,
    sleeper: Sleeper,
    slot: Slot,
    /// Under which `slot` was found.
    switch: Switch,
    /// Frame of the last switch that the partition was started anew for.
    acted: u64,
    log: RecordWriter,
    /// True until the guest's first scan since its start.
    starting: bool,
    first_scan: FirstScan,
    /// True until the first window since the guest was started anew.
    rejoins: bool,
    /// Releases that have passed since the last window.
    skipped: u64,
    tick: Tick,
    counter: GuestCounter,
}

/// How a window ended.
enum Outcome {
    Done,
    Expired,
    Ended(End),
}

/// What running a window found out.
struct Ran {
    entered: Tsc,
    left: Tsc,
    exits: u32,
    outcome: Outcome,
}

impl Windowed {
    /// At the epoch. `log` gets a record for each window.
    #[must_use]
    pub fn new(plan: Plan, base: Timebase, log: RecordWriter) -> Self {
        let switch = plan.board.switch();
        let slot = plan.timetable.first(switch);
        let acted = switch.frame;
        let enforcer = plan.enforcer.clone();
        let rest = plan.quiet.clone().map(|quiet| {
            let rest = Rest::new(quiet, plan.board.clone(), base).reserved(&plan.reservation);
            // A wake-up that tells nothing new is taken from the budget for its next kick.
            rest.on_steered(Box::new(move || {
                if !enforcer.wake_ups().distrusting() {
                    enforcer.kick();
                }
            }))
        });
        let sleeper = Sleeper::new(base.frequency).by_a_clock_whose_steering_is(plan.steering);
        let sleeper = match rest {
            Some(rest) => sleeper.resting(rest),
            None => sleeper,
        };
        Self {
            plan,
            base,
            sleeper,
            slot,
            switch,
            acted,
            log,
            starting: true,
            first_scan: FirstScan::default(),
            rejoins: false,
            skipped: 0,
            tick: Tick::default(),
            counter: GuestCounter::new(base),
        }
    }

    /// True until the guest's first scan since its start. A guest that tells of none never starts,
    /// as far as this knows.
    #[must_use]
    pub fn starting(&self) -> bool {
        self.starting
    }

    /// Runs the guest in its windows until it ends or is stopped.
    pub fn run(
        &mut self,
        kickable: &mut Kickable,
        guest: &mut impl Guest,
        control: &Control,
        health: &mut Reporter,
    ) -> End {
        let mut kernel_exits = kickable.count_exits();
        loop {
            let release = match self.slot {
                Slot::Window(release) => release,
                Slot::Idle(idle) => {
                    let look = self.look(&idle);
                    if !self.sleep(look, control) {
                        return self.leave(self.slot, End::Stopped, control, health);
                    }
                    if let Some(end) = self.pass(look, Tsc::now(), health) {
                        return end;
                    }
                    continue;
                }
            };
            if self.acted != self.switch.frame && self.switch.frame <= release.frame {
                self.acted = self.switch.frame;
                if let Some(mode) = self.plan.on_switch {
                    return self.leave(self.slot, End::ScheduleChange(mode), control, health);
                }
            }
            let start = self.base.instant(release.start);
            let end = self.base.instant(release.end);
            let due = start.before(self.base.frequency.ticks(self.plan.guard.length()));
            let late = self.plan.late_wake_up.delay(release.sequence);
            let slept = self.sleep(due.after(self.base.frequency.ticks(late)), control);
            let woken = Tsc::now();
            // What another partition's thread does at its end can take this one's window.
            if !slept || woken >= end && control.stopping() {
                return self.leave(self.slot, End::Stopped, control, health);
            }
            if woken >= end {
                self.arrived(due, woken);
                if let Some(end) = self.pass(due, woken, health) {
                    return end;
                }
                continue;
            }
            // What the guest is told of the window after this one is also what will be.
            let switch = self.plan.board.switch();
            let next = self.plan.timetable.after(&self.slot, switch);
            guest.announce(&release, &next, &self.base);
            let ran = self.window(kickable, guest, control, end, health);
            let kicked = control.leave_window(end);
            let expired = matches!(ran.outcome, Outcome::Expired);
            self.tick.window_over(kickable.vcpu(), expired);
            let ended = match ran.outcome {
                // A window that the end of the run has cut is not recorded.
                Outcome::Ended(End::Stopped) => {
                    return self.leave(next, End::Stopped, control, health);
                }
                Outcome::Ended(end) => Some(end),
                Outcome::Done | Outcome::Expired => None,
            };
            let counted = kickable.count_exits();
            let mut record = WindowRecord {
                sequence: release.sequence,
                schedule: release.schedule,
                skipped: std::mem::take(&mut self.skipped),
                release: start,
                end,
                due,
                woken,
                entered: ran.entered,
                left: ran.left,
                kicked,
                claim: guest.claim(release.sequence),
                last_stamp: guest.last_stamp(),
                exits: ran.exits,
                kernel_exits: counted.saturating_sub(kernel_exits),
                overrun: expired && guest.says_done(),
                unfinished: false,
                has_tasks: guest.tick().is_some(),
                ended: false,
            };
            if record.has_tasks && record.overrun && record.finished_scan().is_some() {
                (record.overrun, record.unfinished) = (false, true);
            }
            let ended = ended.or_else(|| {
                let missed = self.missed(&record, guest.says_done())?;
                health.raise(missed, 1)
            });
            let ended = ended.or_else(|| {
                let fault =
                    guest.says_done().then(|| self.counter.look(kickable.vcpu(), ran.left))??;
                health.raise(Detail::Clock(fault), 1)
            });
            record.ended = ended.is_some();
            self.log.push(Record::Window(record));
            self.arrived(due, ran.entered);
            // After all that is the partition's own: this one is for the Linuxes beside it.
            if matches!(ran.outcome, Outcome::Done) {
                self.plan.deadlines.iter().for_each(|deadlines| deadlines.window_given_back(end));
            }
            if let Some(end) = ended {
                return end;
            }
            kernel_exits = counted;
            (self.slot, self.switch) = (next, switch);
        }
    }

    /// Lets the guard follow the host: the thread was at its last look at the clock, or should have been,
    /// that much after it was due. One that was started anew in the middle of a window did not sleep.
    fn arrived(&mut self, due: Tsc, at: Tsc) {
        if std::mem::take(&mut self.rejoins) {
            return;
        }
        let arrival = self.base.frequency.nanos(at.since(due));
        if let Some(change) = self.plan.guard.arrived(arrival) {
            self.log.push(Record::Guard(change));
        }
    }

    /// The deadline that a guest has missed in this window. Until its first scan it has none to miss, as in the
    /// figures, but that scan has to come.
    fn missed(&mut self, window: &WindowRecord, says_done: bool) -> Option<Detail> {
        let scanned = window.scan().is_some();
        if !says_done {
            return None;
        }
        if self.starting && !scanned {
            let instants = (window.release, window.end);
            return self.first_scan.missed(window.sequence, instants, self.base.frequency);
        }
        self.starting = false;
        match (window.overrun, scanned) {
            (true, _) => Some(Detail::Overrun(window.sequence)),
            (false, true) => None,
            (false, false) => Some(Detail::Lost(1, window.sequence)),
        }
    }

    /// Sleeps until `instant`; false if the partition is to stop. A kick that comes just before
    /// the sleep is lost, but what it is for is seen before the next one, a frame later at most.
    fn sleep(&mut self, instant: Tsc, control: &Control) -> bool {
        self.sleep_unless(instant, control, Control::stopping)
    }

    fn sleep_unless(
        &mut self,
        instant: Tsc,
        control: &Control,
        ends: fn(&Control) -> bool,
    ) -> bool {
        while !ends(control) {
            if self.sleeper.until(instant, control.wake_ups()) == Woken::OnTime {
                return true;
            }
        }
        false
    }

    /// When to look, in a frame without a window, what the next one has: outside of the windows of others, if that is early
    /// enough.
    fn look(&self, idle: &Idle) -> Tsc {
        let spare = self.plan.timetable.frame().less(self.plan.guard.length());
        let latest = idle.start.plus(Nanos(spare.0 / 2));
        let quiet = self.plan.quiet.as_ref();
        let free = quiet.and_then(|quiet| quiet.next(idle.start, self.switch));
        self.base.instant(free.filter(|free| *free <= latest).unwrap_or(idle.start))
    }

    /// Sleeps until the partition's next window, without a guest; false if the thread is to end. An
    /// order to halt is for a guest, and there is none.
    pub fn next_window(&mut self, control: &Control) -> bool {
        loop {
            self.go_on(Tsc::now());
            let start = match self.slot {
                Slot::Window(release) => self.base.instant(release.start),
                Slot::Idle(idle) => self.look(&idle),
            };
            if !self.sleep_unless(start, control, Control::ending) {
                return false;
            }
            if matches!(self.slot, Slot::Window(release) if Tsc::now() < self.base.instant(release.end))
            {
                return true;
            }
        }
    }

    /// Goes on to the first slot that has not begun at this instant, or lasts. A guest that was taken off while its thread slept
    /// leaves one that is to come: the one after it must not be planned yet.
    fn go_on(&mut self, now: Tsc) {
        let start = match self.slot {
            Slot::Window(release) => release.start,
            Slot::Idle(idle) => idle.start,
        };
        if self.base.instant(start) <= now {
            self.catch_up(now);
        }
    }

    /// The guest was started anew. What has passed are no lost releases: it counts from its own
    /// first scan.
    pub fn restarted(&mut self, vcpu: &VcpuFd, guest: &impl Guest) {
        // A PLC's alone is looked at: the thread of a Linux must not ask for it.
        if guest.says_done() {
            self.counter.restarted(vcpu);
        }
        self.starting = true;
        self.first_scan = FirstScan::default();
        self.rejoins = true;
        self.skipped = 0;
        self.tick.restarted();
        self.catch_up(Tsc::now());
    }

    /// Goes on to the first slot that is not over at this instant.
    fn catch_up(&mut self, now: Tsc) {
        let now = self.base.offset(now);
        self.switch = self.plan.board.switch();
        self.slot = self.plan.timetable.catch_up(&self.slot, now, self.switch);
    }

    /// Runs the guest until it is done, its window ends, or it does.
    fn window(
        &mut self,
        kickable: &mut Kickable,
        guest: &mut impl Guest,
        control: &Control,
        end: Tsc,
        health: &mut Reporter,
    ) -> Ran {
        control.enter_window(end);
        self.tick.window(guest.tick());
        let mut exits = 0u32;
        let mut entered = None;
        let mut last: Option<(Exit, Tsc)> = None;
        loop {
            kickable.clear();
            let now = Tsc::now();
            let first = *entered.get_or_insert(now);
            let left = last.map_or(now, |(_, left)| left);
            let ran = |outcome| Ran { entered: first, left, exits, outcome };
            if control.stopping() {
                return ran(Outcome::Ended(End::Stopped));
            }
            if let Some(end) = guest.ended_from_outside() {
                return ran(Outcome::Ended(end));
            }
            if now >= end {
                return ran(Outcome::Expired);
            }
            if let Err(end) = guest_timer::look_again(guest, kickable.vcpu(), &self.base) {
                return ran(Outcome::Ended(end));
            }
            if let Some((exit, left)) = last.filter(|_| exits <= DETOURS_MAX) {
                self.log.push(Record::Detour(Detour { exit, left, entered: now }));
            }
            self.tick.before_entry(kickable.vcpu());
            let result = kickable.vcpu().run();
            let left = Tsc::now();
            exits = exits.saturating_add(1);
            let ran = |outcome| Ran { entered: first, left, exits, outcome };
            match result {
                Ok(VcpuExit::X86Wrmsr(write)) => {
                    last = Some((Exit::Other, left));
                    let write = guest_timer::take(write);
                    let vcpu = kickable.vcpu();
                    if let Err(end) = guest_timer::write(guest, vcpu, write, &self.base) {
                        return ran(Outcome::Ended(end));
                    }
                }
                // The guest can take its tick now.
                Ok(VcpuExit::IrqWindowOpen) => last = Some((Exit::Other, left)),
                Ok(exit) => {
                    last = Some((reason(&exit), left));
                    let access = Access::of(&exit);
                    let answer = match exit {
                        VcpuExit::IoIn(port, _) | VcpuExit::IoOut(port, _)
                            if guest.has_port(port) =>
                        {
                            Answer::by(access, guest, |guest| {
                                match PortAccess::of(kickable.vcpu()) {
                                    Some(access) => guest.access(access),
                                    None => Step::Ended(End::Kvm(KvmFailure::UnexpectedExit)),
                                }
                            })
                        }
                        exit => Answer::to(exit, guest),
                    };
                    match health.conclude(answer, kickable.vcpu()) {
                        Step::Resume | Step::Raised(_) => {}
                        Step::Done => return ran(Outcome::Done),
                        Step::Ended(ended) => return ran(Outcome::Ended(ended)),
                    }
                }
                Err(e) if matches!(e.errno(), libc::EINTR | libc::EAGAIN) => {
                    last = Some((Exit::Signal, left));
                }
                Err(e) => {
                    let failure = End::Kvm(KvmFailure::Errno(e.errno()));
                    return ran(Outcome::Ended(failure));
                }
            }
        }
    }
}

fn reason(exit: &VcpuExit<'_>) -> Exit {
    match exit {
        VcpuExit::IoOut(port, _) | VcpuExit::IoIn(port, _) => Exit::Port(*port),
        VcpuExit::MmioRead(address, _) | VcpuExit::MmioWrite(address, _) => Exit::Memory(*address),
        _ => Exit::Other,
    }
}
