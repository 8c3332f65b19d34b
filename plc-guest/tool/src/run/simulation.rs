//! A test in Structured Text: a job that asks for time to pass and for the project's tasks to run.
//!
//! The test's process is the program's. While the tasks run, the test waits in the middle of its call: its registers
//! are kept here, and its stack is its own, as each task's is.

use std::time::Duration;

use takt_program::{Task, TaskInformation};
use takt_st::hir::Simulation;

use super::caller::Caller;
use super::child::Registers;
use super::fault::Failed;
use super::machine::{Machine, Paused};
use super::schedule::{Logged, Schedule};

/// How a test ended.
pub enum Verdict {
    Passed,
    /// The assertion of this number did not hold.
    Failed(usize),
}

/// A test that runs.
pub struct TestRun<'m, 'a> {
    machine: &'m mut Machine<'a>,
    schedule: Schedule<'a>,
    task: Task<'a>,
    information: TaskInformation,
    /// Simulated time that a test may let pass.
    most: Duration,
}

impl<'m, 'a> TestRun<'m, 'a> {
    /// A test that is entered by `task`, which the schedule never releases.
    pub fn new(
        machine: &'m mut Machine<'a>,
        schedule: Schedule<'a>,
        task: Task<'a>,
        most: Duration,
    ) -> Self {
        let information = machine.information(0, 0, 0);
        let information = TaskInformation { task: task.id.0.into(), ..information };
        Self { machine, schedule, task, information, most }
    }

    /// Runs it to its end. What it and the tasks log is added, however it ends.
    pub fn run(mut self, logged: &mut Vec<Logged>) -> Result<Verdict, Failed> {
        let mut registers = self.machine.enter(&self.task, self.task.entry, &self.information)?;
        let mut deadline = self.machine.deadline();
        loop {
            let caller = Caller::task(&self.task, self.information.now);
            let name = self.task.name;
            let paused = self.machine.go(name, &self.information, &caller, registers, deadline);
            self.machine.take_log(name, self.information.now, logged);
            match paused? {
                Paused::Ended => return Ok(Verdict::Passed),
                Paused::Asks(Simulation::Fail, number, _) => {
                    return Ok(Verdict::Failed(number as usize));
                }
                Paused::Asks(request @ (Simulation::Take | Simulation::Give), _, at) => {
                    registers = self.machine.exchange(request, *at);
                }
                Paused::Asks(request, nanoseconds, at) => {
                    registers = self.pass(request, nanoseconds, *at, logged)?;
                    // One that lets no time pass goes on with what it has left.
                    if nanoseconds > 0 {
                        deadline = self.machine.deadline();
                    }
                }
            }
        }
    }

    /// Lets time pass. Gives the registers with which the test goes on.
    fn pass(
        &mut self,
        request: Simulation,
        nanoseconds: u64,
        at: Registers,
        logged: &mut Vec<Logged>,
    ) -> Result<Registers, Failed> {
        let left = (self.most.as_nanos() as u64).saturating_sub(self.information.now);
        if nanoseconds.cast_signed() < 0 || nanoseconds > left {
            let what = match nanoseconds.cast_signed() {
                ..0 => "it asks for a negative time".to_owned(),
                _ => format!(
                    "it takes more than {} of simulated time",
                    takt_program::Nanoseconds(self.most.as_nanos() as u64)
                ),
            };
            return Err(self.machine.fault_here(self.task.name, self.information, what, &at));
        }
        if request == Simulation::Run {
            let vectors = self.machine.vectors()?;
            self.schedule.pass(self.machine, nanoseconds, logged)?;
            self.machine.set_vectors(&vectors)?;
        } else {
            self.schedule.skip(nanoseconds);
        }
        self.information.now += nanoseconds;
        self.information.period = nanoseconds;
        self.information.cycle += 1;
        self.machine.inform(&self.information);
        Ok(at)
    }
}
