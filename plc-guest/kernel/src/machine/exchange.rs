//! Inputs before a job, outputs behind it, and the outputs of a program that has stopped.
//!
//! All of it is done with interrupts off, and it may be long: each I/O port is an exit. So it stops at the window's end, and
//! goes on when the task that it is for is the most urgent again.

use super::TASKS;
use super::io::{Job, Pass};
use super::kernel::Kernel;
use takt_kernel::task::TaskId;

/// Which of it has begun.
#[derive(Debug)]
pub struct Exchanges {
    /// Where the inputs or outputs of each task go on.
    next: [u8; TASKS],
    /// Tasks whose jobs are over but for their outputs, a bit for each.
    writing: u64,
    /// Programs that have stopped and whose outputs are still as they were, a bit for each.
    to_stop: u32,
    /// They have waited since the last window began.
    waited: bool,
    /// The one of them whose outputs are being stopped, and where they go on; 0 where they begin.
    stopping: (u8, u8),
}

impl Exchanges {
    /// Nothing has.
    pub const NONE: Self =
        Self { next: [0; TASKS], writing: 0, to_stop: 0, waited: false, stopping: (0, 0) };

    /// A job of this task begins. One before it may have been skipped in the middle.
    #[inline(always)]
    pub fn begin(&mut self, id: TaskId) {
        self.next[id.index()] = 0;
        self.writing &= !(1 << id.0);
    }

    /// True if the job of this task is over but for its outputs.
    #[inline(always)]
    pub const fn writes(&self, id: TaskId) -> bool {
        self.writing != 0 && self.writing & 1 << id.0 != 0
    }

    /// True if outputs of a program that has stopped are still as they were.
    pub const fn stops(&self) -> bool {
        self.to_stop != 0
    }

    /// True if those of this program are.
    pub const fn stops_of(&self, program: u8) -> bool {
        self.to_stop & 1 << program != 0
    }

    /// A window begins. True if outputs have waited for the whole last one to be stopped.
    pub const fn window(&mut self) -> bool {
        let stops = self.stops();
        core::mem::replace(&mut self.waited, stops) && stops
    }

    fn pass(&self, id: TaskId, release: u64) -> Pass {
        Pass { release, next: self.next[id.index()].into() }
    }
}

impl Kernel {
    fn job(&self, id: TaskId) -> Job {
        let place = &self.places[id.index()];
        let released = self.scheduler.task(id).released();
        Job { program: place.program, task: place.number, released, clock: self.clock }
    }

    /// Inputs at the start of a job: those of the program are read, and the task gets them, with the outputs as
    /// they are. Nothing comes between this and the job's first instruction. False if the window has ended before that.
    #[inline(never)]
    pub fn read_inputs(&mut self, id: TaskId) -> bool {
        let job = self.job(id);
        let mut pass = self.exchanges.pass(id, self.window.release);
        let done = self.io.read(job, &mut pass, &self.programs, &mut self.ports);
        self.exchanges.next[id.index()] = if done { 0 } else { pass.next as u8 };
        // All others are in their places since the job began. If the window has ended it is done too: the look for rising edges
        // that follows must not see what was read in the place of a forced value.
        self.put_forced(self.live.forces.inputs_of(job.program));
        if !done {
            return false;
        }
        if let Some(program) = &self.programs[usize::from(job.program)] {
            program.process.give(job.task);
        }
        true
    }

    /// Outputs at the end of a job: those that the task writes are taken from it, and those that are mapped leave the
    /// partition. The job pays for it. False if it does not end now.
    #[inline(never)]
    pub fn write_outputs(&mut self, id: TaskId) -> bool {
        let job = self.job(id);
        if !self.exchanges.writes(id) {
            let Some(program) = &self.programs[usize::from(job.program)] else { return true };
            program.process.take(job.task);
            self.apply_forces(job.program);
        }
        let mut pass = self.exchanges.pass(id, self.window.release);
        let Some(program) = &self.programs[usize::from(job.program)] else { return true };
        self.exchanges.writing |= 1 << id.0;
        let done = self.io.write(job, &mut pass, &program.process, &mut self.ports);
        self.exchanges.next[id.index()] = if done { 0 } else { pass.next as u8 };
        self.charge_work(id, self.stamp, self.entered);
        self.exchanges.writing &= !(u64::from(done) << id.0);
        done && self.scheduler.running() == Some(id)
    }

    /// The jobs of a program are over before their ends: none of them has outputs left to write.
    pub fn abandon_outputs(&mut self, program: u8) {
        for id in self.scheduler.ids() {
            let own = self.places[id.index()].program == program;
            self.exchanges.writing &= !(u64::from(own) << id.0);
        }
    }

    /// Outputs of a program that has stopped take the values that the partition file wants: at once, unless the release
    /// of the window is still to come, which would be late by all of them.
    pub fn stop_outputs(&mut self, program: u8) {
        self.abandon_outputs(program);
        self.exchanges.to_stop |= 1 << program;
        self.exchanges.waited = !self.stop_what_waits();
    }

    /// Stops outputs that wait for it. The release of the window comes first, and its most urgent task; if that has had all
    /// of a window, only the release of the next one. False if none were stopped.
    #[inline(never)]
    pub fn stop_what_waits(&mut self) -> bool {
        let now = self.exchanges.stops()
            && (self.window.is_at_work() || self.window.overdue && self.begin_window().is_some());
        self.exchanges.waited &= !now;
        while now && self.exchanges.stops() {
            let (program, next) = match self.exchanges.stopping {
                (_, 0) => (self.exchanges.to_stop.trailing_zeros() as u8, 0),
                stopping => stopping,
            };
            let mut pass = Pass { release: self.window.release, next: next.into() };
            if let Some(stopped) = &self.programs[usize::from(program)]
                && !self.io.stop(program, &mut pass, &stopped.process, &mut self.ports)
            {
                self.exchanges.stopping = (program, pass.next as u8);
                break;
            }
            self.exchanges.stopping = (0, 0);
            self.exchanges.to_stop &= !(1 << program);
        }
        now
    }
}
