//! The kernel's loop.
//!
//! ```text
//!       window begins (tick, or back from "done")
//!                 |
//!   +---> what is due: releases, time-outs, events <-----------------------+
//!   |             |                                                        |
//!   |       a task is ready? -- no --> wait for a release in this window, -+
//!   |             | yes                or set up some state, or "done"
//!   |       before the release: wait for it
//!   |             |
//!   |       the task runs at ring 3
//!   |             |
//!   +-- tick, call, end of job, fault
//! ```
//!
//! All that a task needs is prepared before the wait for the release, so that between the release and
//! the task's first instruction there is the same short path each time.
//!
//! The time that a task is charged ends with its window: what passes until the next one is not its.

use super::change::Change;
use super::context::{self, Context, Entry, Start};
use super::events::Events;
use super::exchange::Exchanges;
use super::faults::Untold;
use super::figures::Figures;
use super::io::Io;
use super::live::Live;
use super::memory::{Area, Pages};
use super::ports::Ports;
use super::program::Program;
use super::{PROGRAMS, Scheduler, TASKS, processor};
use core::mem::offset_of;
use takt_abi::Information;
use takt_abi::live::ChangeReason;
use takt_abi::program::action;
use takt_kernel::rank::Picked;
use takt_kernel::scheduler::Violation;
use takt_kernel::task::{Release, TaskId, Wake};
use takt_kernel::time::{Clock, Instant, Span};
use takt_plc_guest::console::print;
use takt_plc_guest::{cycle, interrupt, pages, port};
use takt_program::address::CALL_PAGE;
use takt_program::call::{Call, Error};
use takt_program::{Start as StartMode, TaskInformation};

/// A release may be this much early. Instants of windows and of tasks are rounded apart, and a task
/// whose release is a nanosecond after its window's must not wait for the next window.
const ROUNDING: Span = Span(50);
/// Exit code of a guest that a program's error has ended, by the partition file's wish.
const STOPPED_BY_PROGRAM: u32 = 2;

/// Where a task is in the image.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Its program, by its place in the host's table.
    pub program: u8,
    /// Its number; none for the initialisation.
    pub number: Option<u16>,
    /// Where its jobs begin: its function, with the place of the information below, and the top of its stack.
    pub start: Start,
    /// There lies the address to return to.
    pub stack_top: Area,
    /// What it is told about its job.
    pub information: Area,
    /// Its program has inputs or outputs.
    pub has_image: bool,
    /// The tables of its program with its view of the process image.
    pub shown: Shown,
}

impl Place {
    const NONE: Self = Self {
        program: 0,
        number: None,
        start: Start { entry: 0, stack: 0, argument: 0 },
        stack_top: Area::NONE,
        information: Area::NONE,
        has_image: false,
        shown: Shown::NONE,
    };
}

/// A program, and the task whose view of the process image it shows; equal for tasks between which nothing is exchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown(u32);

impl Shown {
    /// No program's.
    pub const NONE: Self = Self(u32::MAX);

    pub const fn new(program: u8, view: u16) -> Self {
        Self((program as u32) << 16 | view as u32)
    }
}

/// The window that the kernel is in.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    pub release: u64,
    pub release_tsc: u64,
    /// The same instant.
    start: Instant,
    pub end_tsc: u64,
    /// Its beginning has been told to the host.
    begun: bool,
    /// It has had time that no task needs; the one before had none.
    pub idled: bool,
    pub starved: bool,
    /// A piece of what is done in such time was done in it beside a task that may never end.
    pub helped: bool,
    /// Outputs of a program that has stopped have waited for the whole of a window.
    pub overdue: bool,
}

impl Window {
    const NONE: Self = Self {
        release: 0,
        release_tsc: 0,
        start: Instant(0),
        end_tsc: 0,
        begun: false,
        idled: true,
        starved: false,
        helped: false,
        overdue: false,
    };

    /// Another one has begun since.
    pub fn is_over(&self) -> bool {
        pages::release() != self.release
    }

    /// Its release is past, and it is not over.
    pub fn is_at_work(&self) -> bool {
        self.begun && !self.is_over()
    }
}

/// All that there is.
#[derive(Debug)]
pub struct Kernel {
    pub scheduler: Scheduler,
    pub contexts: [Context; TASKS],
    pub places: [Place; TASKS],
    pub programs: [Option<Program>; PROGRAMS],
    pub ports: Ports,
    pub events: Events,
    pub clock: Clock,
    pub start: StartMode,
    pub window: Window,
    /// The time stamp at the last entry, and that time.
    pub stamp: u64,
    pub entered: Instant,
    /// Inputs and outputs that are being read and written.
    pub exchanges: Exchanges,
    /// What tables are in use.
    pub shown: Shown,
    /// What is mapped to inputs and outputs.
    pub io: Io,
    /// Tasks with an error in [`untold`](Self::untold), a bit for each.
    pub has_untold: u64,
    /// Errors of tasks whose lines wait.
    pub untold: [Option<Untold>; TASKS],
    pub figures: Figures,
    /// Orders from Takt, and answers.
    pub live: Live,
    /// The change of a program to another version.
    pub change: Change,
    /// Where the pages of programs come from; none before the first.
    pub pages: Option<Pages>,
    /// The page to which tasks return.
    pub call_page: Area,
}

impl Kernel {
    /// With nothing in it.
    pub const EMPTY: Self = Self {
        scheduler: Scheduler::new(),
        contexts: [const { Context::EMPTY }; TASKS],
        places: [Place::NONE; TASKS],
        programs: [const { None }; PROGRAMS],
        ports: Ports::CLOSED,
        events: Events::NONE,
        clock: Clock::new(0, 1_000_000),
        start: StartMode::Cold,
        window: Window::NONE,
        exchanges: Exchanges::NONE,
        stamp: 0,
        entered: Instant(0),
        shown: Shown::NONE,
        io: Io::NONE,
        has_untold: 0,
        untold: [None; TASKS],
        figures: Figures::START,
        live: Live::CLOSED,
        change: Change::NONE,
        pages: None,
        call_page: Area::NONE,
    };

    /// Runs for ever. Everything is loaded.
    pub fn run(&mut self) -> ! {
        for program in self.scheduler.programs() {
            self.scheduler.start(program, Instant(0));
        }
        // The start-up has reached into some window. The tasks' time begins with a whole one.
        port::write(takt_abi::port::DONE, 0);
        let first = pages::information();
        self.clock = Clock::new(first.release_tsc, first.tsc_khz);
        self.enter_window(&first);
        self.pass_time(self.window.start);
        loop {
            // It opens the door to interrupts, and a tick that comes in by it is dropped: so before the look.
            if !self.events.is_empty() {
                interrupt::end();
                let now = self.now();
                let change = &self.change;
                let leaving = |program| change.is_leaving(program);
                self.events.poll(&mut self.scheduler, &mut self.ports, now, leaving);
            }
            if self.window.is_over() {
                self.enter_window(&pages::information());
                self.pass_time(self.now().max(self.window.start));
            }
            if self.exchanges.stops() {
                self.stop_what_waits();
            }
            if self.has_untold != 0 {
                self.print_untold();
            }
            match self.scheduler.pick() {
                Some(picked) => {
                    if !self.scheduler.task(picked.task).is_bounded() {
                        self.help_others();
                    }
                    self.dispatch(picked);
                }
                None => self.idle(),
            }
        }
    }

    /// Does what is due at this instant.
    pub fn pass_time(&mut self, now: Instant) {
        self.scheduler.advance(now.after(ROUNDING));
        self.see_to_the_late();
    }

    /// The time.
    pub fn now(&self) -> Instant {
        self.clock.instant(cycle::now())
    }

    /// The time at the last entry of a task.
    pub const fn entered(&self) -> Instant {
        self.entered
    }

    fn enter_window(&mut self, information: &Information) {
        let start = self.clock.instant(information.release_tsc);
        self.window = Window {
            release: information.release,
            release_tsc: information.release_tsc,
            start,
            end_tsc: information.window_end_tsc,
            starved: !self.window.idled,
            idled: false,
            overdue: self.exchanges.window(),
            ..Window::NONE
        };
        self.scheduler.window(start);
    }

    /// Waits for the release, if it is still to come, and tells the host that the window's work begins.
    /// Returns the time stamp; none if the window is over by then.
    #[inline(always)]
    pub fn begin_window(&mut self) -> Option<u64> {
        if self.window.begun { Some(cycle::now()) } else { self.wait_for_release() }
    }

    #[inline(never)]
    fn wait_for_release(&mut self) -> Option<u64> {
        let release = self.window.release;
        let tsc = processor::wait_until(self.window.release_tsc);
        if self.window.is_over() {
            return None;
        }
        self.window.begun = true;
        pages::publish_start(release, tsc);
        pages::publish_done(tsc);
        Some(tsc)
    }

    /// Gives a task the processor, and sees to what it comes back with.
    #[inline(always)]
    fn dispatch(&mut self, picked: Picked) {
        let Picked { task, begins, starts, wake } = picked;
        let program = self.places[task.index()].program;
        self.live.watch.give_up();
        if self.change.is_of(program) {
            if self.change.is_leaving(program) {
                // The version has failed, and what it replaced is about to come back.
                let now = self.now();
                self.scheduler.skip(task, now);
                return;
            }
            self.change.program_runs(program);
        }
        if begins {
            self.begin_job(task);
        } else if let Some(wake) = wake {
            self.end_wait(task, wake);
        } else if (self.has_untold != 0 || interrupt::is_unended()) && self.begin_window().is_some()
        {
            // A job that goes on is in no hurry, and it may be all that is left of each window.
            interrupt::end();
            self.print_untold();
        }
        self.enter_space(task);
        if self.live.forces.count() != 0 {
            if begins && !self.live.forces.is_settled(program) {
                self.apply_forces(program);
            }
            self.live.forces.unsettle(program);
        }
        // If the window is over by now, all that was prepared waits for the next one.
        let Some(from) = self.begin_window() else { return };
        let past = self.clock.span(from - self.window.release_tsc);
        let at = Instant(self.window.start.0 + past.0);
        if at >= self.scheduler.next_event() {
            // It may be that a more urgent one is released.
            self.pass_time(at);
            return;
        }
        if self.exchanges.writes(task) {
            (self.stamp, self.entered) = (from, at);
            return self.end(task);
        }
        if starts {
            if self.places[task.index()].has_image && !self.read_inputs(task) {
                return self.charge_work(task, from, at);
            }
            self.scheduler.begins(task, at);
        }
        let context = &mut self.contexts[task.index()];
        let entry = loop {
            match context::run(context, &self.places[task.index()].start, self.window.release) {
                // The time is told without a look at anything else.
                Entry::Call if context.registers.rax == u64::from(Call::Time as u32) => {
                    context.registers.rax = self.clock.instant(cycle::now()).0;
                }
                entry => break entry,
            }
        };
        match (self.charge(task, from, at), entry) {
            (None, Entry::Tick) => {}
            (None, Entry::Call) => self.call(task),
            (None, Entry::End) => self.end(task),
            (None, Entry::Fault) => self.fault(task),
            (Some(violation), entry) => self.entered_late(task, entry, violation),
        }
    }

    /// A task has entered the kernel after it has used up its budget. What a fault or STOP leads to, no action after that
    /// takes back.
    #[inline(never)]
    fn entered_late(&mut self, task: TaskId, entry: Entry, violation: Violation) {
        let ends = match entry {
            Entry::Tick | Entry::End => false,
            Entry::Call => {
                self.contexts[task.index()].registers.rax == u64::from(Call::Stop as u32)
            }
            Entry::Fault => true,
        };
        match entry {
            Entry::Fault => self.fault(task),
            _ if ends => self.call(task),
            _ => {}
        }
        if !ends || self.entry_of(task).on_overrun == action::STOP_PARTITION {
            self.violated(task, violation);
        }
        if self.scheduler.running() == Some(task) {
            match entry {
                // A STOP that comes too late in its window is made again.
                Entry::Call if !ends => self.call(task),
                Entry::End => self.end(task),
                Entry::Tick | Entry::Call | Entry::Fault => {}
            }
        }
    }

    /// A task has caused an exception.
    #[inline(never)]
    fn fault(&mut self, task: TaskId) {
        let leads_back = self.change.leads_back(self.places[task.index()].program);
        if let Some(fault) = context::last_fault() {
            self.tell(task, Untold::Fault(fault, leads_back));
        }
        if !self.trial_fails(task, ChangeReason::Fault) {
            self.act(task, self.entry_of(task).on_fault);
        }
    }

    /// Charges a task, which was running, with the time since then, up to the end of the window that it was in.
    #[inline(always)]
    pub fn charge(&mut self, id: TaskId, from: u64, at: Instant) -> Option<Violation> {
        self.stamp = cycle::now();
        let ran = self.clock.span(self.stamp.min(self.window.end_tsc).saturating_sub(from));
        self.entered = Instant(at.0.wrapping_add(ran.0));
        self.scheduler.account(id, ran)
    }

    /// Charges a task with what the kernel has done for it since then.
    #[inline(never)]
    pub fn charge_work(&mut self, id: TaskId, from: u64, at: Instant) {
        if let Some(violation) = self.charge(id, from, at) {
            self.violated(id, violation);
        }
    }

    /// Uses the tables of a task's program, with the task's view of the process image.
    #[inline(always)]
    fn enter_space(&mut self, id: TaskId) {
        if self.shown != self.places[id.index()].shown {
            self.exchange_space(self.places[id.index()]);
        }
    }

    #[inline(never)]
    fn exchange_space(&mut self, place: Place) {
        let Some(program) = &self.programs[usize::from(place.program)] else { return };
        self.shown = place.shown;
        program.process.show(program.space, place.number);
        program.space.enter();
    }

    /// Stops the program of a task that has failed.
    fn fail(&mut self, id: TaskId) {
        self.scheduler.fail(id);
        self.stop_outputs(self.places[id.index()].program);
    }

    #[inline(always)]
    fn begin_job(&mut self, id: TaskId) {
        let (task, place) = (self.scheduler.task(id), &self.places[id.index()]);
        // What is the same for all its jobs is there since the program's start.
        let words = [task.cycle(), task.released().0, task.elapsed().0];
        place.information.set_words(offset_of!(TaskInformation, cycle) as u64, words);
        place.stack_top.set_words(0, [CALL_PAGE]);
        self.contexts[id.index()].begin();
        if place.has_image {
            self.exchanges.begin(id);
        }
    }

    /// The result of a call that has waited.
    #[inline(always)]
    fn end_wait(&mut self, id: TaskId, wake: Wake) {
        let result = match wake {
            Wake::TimedOut => Error::TimedOut.result(),
            Wake::Flags(flags) => i64::from(flags),
            // The sender has written the message and its length.
            Wake::Message => return,
        };
        self.contexts[id.index()].registers.rax = result as u64;
    }

    /// The job of the running task is complete.
    #[inline(always)]
    pub fn end(&mut self, id: TaskId) {
        let Place { program, has_image, .. } = self.places[id.index()];
        if has_image && !self.write_outputs(id) {
            return;
        }
        if self.live.forces.count() != 0 {
            self.apply_forces(program);
            self.live.forces.settle(program);
        }
        pages::publish_done(self.stamp);
        // Outputs that were written behind the window's end are told as late as they were.
        let over = self.stamp > self.window.end_tsc;
        let now = if over { self.clock.instant(self.stamp) } else { self.entered() };
        if let Some(violation) = self.scheduler.end(now) {
            self.violated(id, violation);
        }
        self.change.job_ends(program);
        self.see_to_the_late();
    }

    fn entry_of(&self, id: TaskId) -> &takt_abi::program::Program {
        let program = usize::from(self.places[id.index()].program);
        self.programs[program].as_ref().map_or(&takt_abi::program::Program::NONE, |p| &p.entry)
    }

    fn see_to_the_late(&mut self) {
        while let Some(late) = self.scheduler.take_late() {
            self.violated(late, Violation::Deadline);
        }
    }

    /// A job has not kept a limit.
    #[inline(never)]
    pub fn violated(&mut self, id: TaskId, violation: Violation) {
        let entry = self.entry_of(id);
        let (what, wanted) = match violation {
            Violation::Budget => ("has used up its budget", entry.on_overrun),
            Violation::Deadline => ("was not complete at its deadline", entry.on_deadline),
        };
        // Some of its outputs have left: it is complete when all have.
        let wanted = match wanted {
            action::SKIP if self.exchanges.writes(id) => action::LOG,
            wanted => wanted,
        };
        let leaves = violation == Violation::Budget
            && self.change.leads_back(self.places[id.index()].program);
        self.tell(id, Untold::Violation { what, wanted, leaves });
        if violation == Violation::Budget && self.trial_fails(id, ChangeReason::Budget) {
            return;
        }
        self.act(id, wanted);
    }

    /// What the partition file wants after an error of a task.
    pub fn act(&mut self, id: TaskId, wanted: u32) {
        let place = self.places[id.index()];
        // A version that has failed is about to go back. To stop or start it now would lose the way back.
        let wanted = if self.change.is_leaving(place.program) { action::LOG } else { wanted };
        match wanted {
            action::LOG => {}
            action::SKIP if self.scheduler.task(id).settings().release != Release::Start => {
                // A violation that is found at a job's end is not the next one's.
                if self.scheduler.task(id).has_violated() {
                    let now = self.now();
                    self.scheduler.skip(id, now);
                }
            }
            action::WARM_RESTART_PROGRAM | action::RESTART_PROGRAM => {
                self.change.forget(place.program);
                self.fail(id);
                if let Some(program) = &mut self.programs[usize::from(place.program)] {
                    let warm = wanted == action::WARM_RESTART_PROGRAM;
                    let start = if warm { StartMode::Warm } else { StartMode::Cold };
                    program.reload(self.window.release, start);
                }
            }
            action::STOP_PARTITION => {
                self.print_all_untold();
                self.print_figures();
                print(format_args!("the partition ends itself, as its file says"));
                port::exit(STOPPED_BY_PROGRAM);
            }
            _ => {
                self.change.forget(place.program);
                self.fail(id);
            }
        }
    }
}
