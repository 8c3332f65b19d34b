//! What is kept of one partition while it runs.

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use takt_devices::output::{Allowance, OutputEnd};
use takt_devices::watchdog::Timer;
use takt_scheduler::guard::GuardChange;
use takt_scheduler::switch::Switch;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Nanos, Timebase, TscFrequency};
use takt_scheduler::timetable::{Slot, Timetable};

use crate::attendance::Attendance;
use crate::console_log::ConsoleLog;
use crate::delay::Delay;
use crate::disk::DiskWatch;
use crate::handoff::Taker;
use crate::health::{Detail, Watch};
use crate::init_watch::Console;
use crate::kernel_watch::{KernelWatch, News};
use crate::life::{Effects, Event, Finished, Life};
use crate::live::Banks;
use crate::load;
use crate::power_button::PowerButton;
use crate::report;
use crate::restart::Restart;
use crate::samples::{Course, Recorder};
use crate::screen::Screen;
use crate::statistics;
use crate::terminal::Lines;
use crate::vcpu::Control;
use crate::vcpu::guest_timer::Deadlines;
use crate::vcpu::record::{Detour, Record, WindowRecord};
use crate::vcpu::records::RecordReader;
use crate::vhost::LinkWatch;
use takt_record::WindowAssembler;

/// Time between two looks, in ns, from which on it is taken that Takt itself was stopped. It looks fifty times a second.
const STOPPED: u64 = 1_000_000_000;

/// The supervisor thread's side of a partition.
pub struct Account {
    /// The name in front of its lines.
    pub name: String,
    /// For stopping it.
    pub control: Arc<Control>,
    /// The same of the threads of further processors, which come and go with the first.
    pub further: Vec<Arc<Control>>,
    /// Console output.
    pub output: OutputEnd,
    /// Bytes of it that were taken out of the ring and not shown.
    pub unshown: u64,
    /// True if the output is a terminal's, to be shown unchanged.
    pub is_terminal: bool,
    /// True if the output is on the screen.
    pub is_shown: bool,
    /// The file that keeps the output, if its file wants that.
    pub log: Option<ConsoleLog>,
    /// What is typed goes here, if its guest has a console to type at.
    pub keyboard: Option<Console>,
    /// What its thread recorded; `None` for a background partition.
    pub records: Option<RecordReader>,
    /// Detours whose window is not in the ring yet.
    pub assembler: WindowAssembler,
    /// Whether its windows are entered, if its guest tells of its scans.
    pub attendance: Option<Attendance>,
    /// True if its guest tells of its scans.
    pub says_done: bool,
    /// What becomes of its errors.
    pub health: Watch,
    /// Figures of a partition whose guest does, from the epoch on.
    pub releases: Option<statistics::Releases>,
    /// How its releases go, if that is wanted.
    pub samples: Option<Recorder>,
    /// How the load of its Linux goes, if that is wanted.
    pub load: Option<load::Recorder>,
    /// Time from its wake-ups to its leaving its windows.
    pub occupied: Nanos,
    /// What notices that its guest is silent.
    pub watchdog: Option<Timer>,
    /// When its silent guest has to leave: in its next window, if it has windows.
    pub leaves_by: Nanos,
    /// The watchdog's clock when it was last looked at.
    pub looked: u64,
    /// Its windows, if it has any.
    pub timetable: Option<Timetable>,
    /// What notices that its kernel does nothing any more; only of a Linux.
    pub kernel: Option<KernelWatch>,
    /// What notices errors of its disks.
    pub disks: Vec<DiskWatch>,
    /// What notices that the host's kernel does not take the queues of its interfaces or sockets.
    pub links: Vec<LinkWatch>,
    /// Where the deadlines of its processors' timers are placed; empty if Takt does not do that.
    pub deadlines: Vec<Arc<Deadlines>>,
    /// Where other versions of its programs are put; `None` if it has no programs.
    pub banks: Option<Banks>,
    /// For asking it to switch itself off, if its file wants that.
    pub power_button: Option<PowerButton>,
    /// For starting its guest anew; `None` if it cannot be.
    pub restart: Option<Restart>,
    /// What its thread tells of its ends.
    pub ends: Taker<Finished>,
    /// Whether its guest runs, and what is to become of it.
    pub life: Life,
    /// What its threads have still to come to.
    pub delay: Delay,
    /// Output that is no whole line yet.
    pub lines: Lines,
}

impl Account {
    /// The run starts, and its releases are to be sampled or not.
    pub fn start(&mut self, base: Timebase, sampled: bool) {
        if self.records.is_some() && self.says_done {
            self.releases = statistics::Releases::new(base);
            self.samples = sampled.then(|| Recorder::new(base)).flatten();
        }
        self.load = (sampled && self.is_terminal).then(load::Recorder::default);
    }

    /// Bytes of console output that were dropped, wherever.
    #[must_use]
    pub fn console_dropped(&self) -> u64 {
        self.output.dropped() + self.unshown
    }

    /// Shows what its guest has written: all that waits, unless it is a guest that can wait and there is
    /// no room for all. `last` takes all. Returns what was taken, shown or not.
    pub fn show(&mut self, id: PartitionId, screen: &mut Screen, last: bool) -> Vec<u8> {
        let mut bytes = Vec::new();
        let waits = self.output.waits() && !last;
        let most = match (waits, self.is_shown) {
            (false, _) => Allowance::ALL,
            (true, true) => screen.allowance(id),
            (true, false) => screen.budget(id),
        };
        self.output.take_into(&mut bytes, most);
        if self.output.waits() && !bytes.is_empty() {
            [&self.control].into_iter().chain(&self.further).for_each(|control| control.wake());
        }
        if let Some(log) = &mut self.log {
            log.take(&bytes, Instant::now());
        }
        if !self.is_shown {
            screen.spend(id, &bytes);
        } else if self.is_terminal {
            self.unshown += screen.raw(id, &bytes);
        } else {
            let Self { lines, name, unshown, .. } = self;
            lines.add(&bytes, |line| *unshown += screen.guest_line(id, name, line));
        }
        bytes
    }

    /// Shows what is left of an unfinished line.
    pub fn finish_line(&mut self, id: PartitionId, screen: &mut Screen) {
        let Self { lines, name, unshown, .. } = self;
        lines.finish(|line| *unshown += screen.guest_line(id, name, line));
    }

    /// How its releases went; `None` if that was not wanted.
    #[must_use]
    pub fn course(&self) -> Option<Course> {
        Some(self.samples.as_ref()?.course(&self.name, self.releases.as_ref()?))
    }

    /// What the load of its Linux has got done until it was asked to switch itself off, or until the end of the run.
    #[must_use]
    pub fn load_course(&self, end: Nanos) -> Option<load::Course> {
        self.load.as_ref()?.course(&self.name, end)
    }

    /// With what can start its guest anew.
    pub fn can_restart(&mut self, restart: Restart) {
        self.life = Life::new(restart.starts());
        self.restart = Some(restart);
    }

    /// Goes on by an event, and [carries out](Self::carry_out) what follows. The rest is the supervisor's.
    pub fn step(&mut self, event: Event) -> Effects {
        let effects = self.life.step(event);
        self.carry_out(&effects);
        effects
    }

    /// Does what follows from an event or an order, for its thread.
    pub fn carry_out(&mut self, effects: &Effects) {
        if effects.halt {
            self.control.halt();
        }
        if effects.release {
            self.control.halted();
        }
        if let Some(start) = effects.load {
            if let Some(restart) = &mut self.restart {
                restart.start(start);
            }
            self.restarted();
        }
    }

    fn restarted(&mut self) {
        if let Some(kernel) = &mut self.kernel {
            kernel.restarted();
        }
        if let Some(releases) = &mut self.releases {
            releases.restarted();
        }
        if let Some(samples) = &mut self.samples {
            samples.restarted();
        }
    }

    /// The figures of its releases up to now, with the count of windows that they lack; `None` if it has none.
    #[must_use]
    pub fn figures(&self) -> Option<report::Releases> {
        let unrecorded = self.records.as_ref().map_or(0, RecordReader::unrecorded);
        Some(self.releases.as_ref()?.report(unrecorded))
    }

    /// Time in its windows that no other partition could use. A guest that does not say when it is done stays in them, and
    /// gives its CPU away while it waits.
    #[must_use]
    pub fn used(&self) -> Nanos {
        match (&self.records, self.life.finished()) {
            (Some(_), Some(finished)) if !self.says_done => finished.cpu_time,
            _ => self.occupied,
        }
    }

    /// Presses its power button, if it has one. From then on it is not started any more: a guest that is being started
    /// is taken off its processor before it has begun. Returns what is told, and how long a guest has that runs.
    pub fn ask_to_power_off(&mut self, now: Nanos) -> Option<(Option<Nanos>, &'static str)> {
        let button = self.power_button.as_mut()?;
        let (up, runs) = (self.life.is_up(), self.control.has_guest());
        if up && runs {
            button.press(now);
            // A Linux that switches itself off makes no load any more, and the run waits for it.
            if let Some(load) = &mut self.load {
                load.end(now);
            }
        }
        let patience = runs.then(|| button.patience());
        self.step(Event::RunOver);
        if up && !runs {
            self.control.halt();
        }
        let text =
            if runs { "asked to power off" } else { "not started again, since the run ends" };
        up.then_some((patience, text))
    }

    /// Takes note of an error of the host's, and ends its guest if its table does not let it go on.
    pub fn raise(&mut self, detail: Detail, now: Nanos, show: impl FnMut(&str)) {
        if self.life.is_up() && !self.health.raise(detail, now, show).goes_on() {
            self.step(Event::HostFault(detail));
        }
    }

    /// Ends its guest if that has been silent for too long by `clock`. The time does not run while the schedule has no
    /// window for it. It begins anew after Takt was stopped (SIGSTOP): the clock has run on, and the guest has not.
    pub fn look_for_silence(&mut self, clock: u64, switch: Switch, now: Nanos) {
        let Some(timer) = &self.watchdog else { return };
        let gap = clock.saturating_sub(mem::replace(&mut self.looked, clock));
        let slot = self.timetable.as_ref().map(|t| t.catch_up(&t.first(switch), now, switch));
        if gap >= STOPPED || matches!(slot, Some(Slot::Idle(_))) {
            timer.hold(clock);
        } else if timer.expires(clock) {
            // The thread finds the reason in the timer, one with windows only in them.
            self.leaves_by = if let Some(Slot::Window(next)) = slot { next.end } else { now };
            // A kick between its windows would wake it in one of another partition.
            if slot.is_none() {
                self.control.kick();
            }
        }
    }

    /// Looks whether its kernel does something. A thread with windows is not asked: it has little to
    /// do in them, and how it is can be told from them.
    pub fn look_at_kernel(&mut self, base: &Timebase, now: Nanos) -> Option<News> {
        let runs = self.life.is_up() && self.control.has_guest();
        let control = (runs && self.records.is_none()).then_some(&*self.control);
        self.kernel.as_mut()?.look(base, now, control)
    }

    /// Looks whether its guest has not left, or not started again, long after it had to. Says so once.
    pub fn look_for_delay(&mut self, now: Nanos) -> Option<&'static str> {
        let silent = self.watchdog.as_ref().is_some_and(Timer::has_expired);
        let silent = silent && now >= self.leaves_by;
        // The first processor halts the further ones when it has left.
        let mut controls = [&self.control].into_iter().chain(&self.further);
        let leaves = silent || controls.any(|control| control.stopping());
        let awaited = match (self.life.is_up(), self.control.has_guest()) {
            (true, true) if leaves => Some(
                "it does not leave its processor, 1 s after it had to: the host's kernel may keep it",
            ),
            (true, false) => Some("it does not run yet, 1 s after it had to start"),
            _ => None,
        };
        self.delay.look(awaited, now)
    }

    /// The error that its thread does not come to its windows. All that it has recorded before `now` must have been
    /// taken.
    pub fn look_for_absence(&mut self, switch: Switch, now: Nanos) -> Option<Detail> {
        // One that is to leave is told of as such.
        let comes = self.control.has_guest() && !self.control.stopping();
        let occupied = comes.then_some(self.occupied);
        self.attendance.as_mut()?.look(occupied, switch, now)
    }

    /// Takes everything out of the ring of records, and shows each window with its detours. Returns the
    /// changes of the release guard that are to be told, the latest last.
    pub fn take_records(
        &mut self,
        frequency: TscFrequency,
        mut show: impl FnMut(&str, &WindowRecord, &[Detour]),
    ) -> Vec<GuardChange> {
        let mut changes = Vec::new();
        let Some(records) = &mut self.records else { return changes };
        while let Some(record) = records.pop() {
            match (&record, &mut self.releases) {
                (Record::Guard(change), _) => changes.push(*change),
                (Record::Skipped(skipped), Some(releases)) => releases.skip(skipped),
                _ => {}
            }
            let Some((window, detours)) = self.assembler.add(&record) else { continue };
            self.occupied = self.occupied.plus(frequency.nanos(window.left.since(window.due)));
            show(&self.name, &window, detours);
            if let Some(releases) = &mut self.releases {
                releases.add(&window, detours);
            }
            if let Some(samples) = &mut self.samples {
                samples.add(&window);
            }
        }
        changes
    }
}
