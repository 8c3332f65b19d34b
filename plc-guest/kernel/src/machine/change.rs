//! The change of a program to another version, while it runs.
//!
//! Takt has checked the new version and has put it into the program's free bank, with a plan of what becomes of
//! each value, and a plan back. The kernel checks the plans and maps the pages in idle time, a few at a time
//! ([`preparing`](super::preparing)), and waits for an order. Then, in idle time with no job of the program under way and time
//! enough before the next release, it carries out the plan and changes one word of the page tables. The version is on trial for
//! [`TRIAL_JOBS`] jobs: a fault, or a job over its budget, leads back. So it does when an order to go back waits for the end of a
//! job.
//!
//! For a large change the values are carried to a second state beforehand ([`carrying`](super::carrying)), and only the
//! word is left to be changed.
//!
//! A place that an operator forces or watches is some bytes of the version that runs. So no change begins while a value
//! of the program is forced, and until the trial is over none is written, forced or watched.
//!
//! The way back is the same, with the other plan. Values are those that the failed version has left.

use super::carrying::Carrying;
use super::kernel::{Kernel, Shown};
use super::preparing::Piece;
use super::program::STATE;
use super::start::settings_of;
use super::version::{Lengths, Other, Way};
use takt_abi::live::{Answer, ChangePhase, ChangeReason, ChangeRecord, ChangeStep, Refusal};
use takt_change::Ready;
use takt_kernel::scheduler::Phase;
use takt_kernel::task::{ProgramId, TaskId};
use takt_kernel::time::{Instant, Span};
use takt_plc_guest::cycle;
use takt_program::address::CODE;

/// Jobs, of all tasks together, after which a version is no longer on trial.
pub const TRIAL_JOBS: u32 = 100;
/// Time that one piece of the preparation may take.
const PIECE: Span = Span(60_000);
/// Time that must be left before the next release for a commit of 10 us.
const COMMIT: Span = Span(20_000);
/// A change. There is one at a time.
#[derive(Debug)]
pub struct Change {
    pub record: ChangeRecord,
    /// What is to be done next while it is prepared.
    pub piece: Option<Piece>,
    /// The version in the other bank, and how values get there.
    pub other: Option<Other>,
    /// How far they have come, if that version has a state of its own.
    pub carrying: Carrying,
}

impl Change {
    /// No program changes.
    pub const NONE: Self = Self {
        record: ChangeRecord {
            program: 0,
            phase: ChangePhase::None,
            reason: ChangeReason::None,
            jobs: 0,
            gone: 0,
            took: 0,
            at: 0,
            cycle: 0,
            carried: 0,
            carrying: 0,
        },
        piece: None,
        other: None,
        carrying: Carrying::AFTER_EXCHANGE,
    };

    /// True if this program is the one that changes, or has changed.
    pub fn is_of(&self, program: u8) -> bool {
        self.record.phase != ChangePhase::None && self.record.program == program
    }

    fn is(&self, program: u8, phase: ChangePhase) -> bool {
        self.record.program == program && self.record.phase == phase
    }

    /// A task of this program gets the processor, or the kernel writes to its state.
    pub fn program_runs(&mut self, program: u8) {
        if self.record.program == program {
            self.carrying.program_runs();
        }
    }

    /// True if the other version has a state of its own that has not got all values.
    fn is_behind(&self) -> bool {
        let second = self.other.is_some_and(|o| matches!(o.way, Way::ToSecondState { .. }));
        second && !self.carrying.is_done()
    }

    /// True if an error of this program leads back to its version before: on trial, and when an order leads there already
    /// that waits for the end of the program's jobs.
    pub fn leads_back(&self, program: u8) -> bool {
        self.is(program, ChangePhase::Trial)
            || self.is(program, ChangePhase::RollingBack) && !self.is_leaving(program)
    }

    /// True from the order to change this program until its trial is over: places in it can be those of another
    /// version, so they are not watched, written or forced.
    pub fn is_unsettled(&self, program: u8) -> bool {
        self.is(program, ChangePhase::Committing)
            || self.is(program, ChangePhase::Trial)
            || self.is(program, ChangePhase::RollingBack)
    }

    /// True if the running version of this program has failed.
    pub fn is_leaving(&self, program: u8) -> bool {
        self.is(program, ChangePhase::RollingBack) && self.record.reason != ChangeReason::Order
    }

    /// A job of this program is complete.
    pub fn job_ends(&mut self, program: u8) {
        if self.record.phase == ChangePhase::Trial && self.record.program == program {
            self.record.jobs += 1;
            if self.record.jobs >= TRIAL_JOBS {
                self.record.phase = ChangePhase::Held;
            }
        }
    }

    /// The program stops, or starts anew: there is nothing to go back to.
    pub fn forget(&mut self, program: u8) {
        let under_way = !matches!(
            self.record.phase,
            ChangePhase::None | ChangePhase::RolledBack | ChangePhase::Refused
        );
        if self.record.program == program && under_way {
            self.end(ChangePhase::None, ChangeReason::Stopped);
        }
    }

    fn end(&mut self, phase: ChangePhase, reason: ChangeReason) {
        (self.piece, self.other) = (None, None);
        (self.record.phase, self.record.reason) = (phase, reason);
    }
}

impl Kernel {
    /// Takes the order to prepare what lies in the program's other bank.
    pub fn prepare_change(&mut self, program: u8, bytes: [u64; 3]) -> Result<(), Refusal> {
        let Some(Some(changing)) = self.programs.get(usize::from(program)) else {
            return Err(Refusal::NoProgram);
        };
        // Its state is about to get initial values, and with them what a change has put there.
        if changing.is_loading() {
            return Err(Refusal::NotNow);
        }
        // One that has stopped is never between two jobs again: its next life begins with a start of the guest.
        if self.scheduler.phase(ProgramId(program)) == Phase::Stopped {
            return Err(Refusal::NotNow);
        }
        match self.change.record.phase {
            ChangePhase::Committing | ChangePhase::Trial | ChangePhase::RollingBack => {
                return Err(Refusal::NotNow);
            }
            _ => {}
        }
        let phase = ChangePhase::Preparing;
        let record = ChangeRecord { program, phase, ..ChangeRecord::default() };
        let piece = Some(Piece::Image(Lengths(bytes)));
        self.change = Change { record, piece, other: None, carrying: Carrying::begin() };
        Ok(())
    }

    /// Takes the order to go on.
    pub fn go_on_with_change(&mut self, program: u8, step: ChangeStep) -> Answer {
        let change = &mut self.change;
        if change.record.program != program {
            let known = self.programs.get(usize::from(program)).is_some_and(Option::is_some);
            return match step {
                ChangeStep::Tell if known => {
                    Answer::Change(ChangeRecord { program, ..ChangeRecord::default() })
                }
                _ if known => Answer::Reply(Err(Refusal::NotNow)),
                _ => Answer::Reply(Err(Refusal::NoProgram)),
            };
        }
        let ordered = (ChangePhase::RollingBack, ChangeReason::Order);
        match (step, change.record.phase) {
            (ChangeStep::Tell, _) => {}
            // A forced value is some bytes at a place, which is another value's in the other version.
            (ChangeStep::Commit, ChangePhase::Prepared)
            | (ChangeStep::RollBack, ChangePhase::Trial | ChangePhase::Held)
                if self.live.forces.any(program) =>
            {
                return Answer::Reply(Err(Refusal::Forced));
            }
            (ChangeStep::Commit, ChangePhase::Prepared) => {
                change.record.phase = ChangePhase::Committing;
                self.live.watch.leave(program);
            }
            (ChangeStep::RollBack, ChangePhase::Trial | ChangePhase::Held) => {
                (change.record.phase, change.record.reason) = ordered;
                self.live.watch.leave(program);
            }
            (
                ChangeStep::RollBack,
                ChangePhase::Preparing | ChangePhase::Prepared | ChangePhase::Committing,
            ) => change.end(ChangePhase::None, ChangeReason::Order),
            _ => return Answer::Reply(Err(Refusal::NotNow)),
        }
        Answer::Change(self.change.record)
    }

    /// Does a piece of a change, if there is one to do and time for it. True if it has.
    pub fn change_some(&mut self, end_tsc: u64) -> bool {
        let phase = self.change.record.phase;
        let behind = self.change.is_behind();
        let needed = match phase {
            ChangePhase::Preparing => PIECE,
            ChangePhase::Committing | ChangePhase::Trial | ChangePhase::RollingBack if behind => {
                PIECE
            }
            ChangePhase::Committing | ChangePhase::RollingBack => COMMIT,
            _ => return false,
        };
        let end = self.clock.instant(end_tsc).min(self.scheduler.next_event());
        if self.now().after(needed) > end {
            return false;
        }
        match phase {
            ChangePhase::Preparing => {
                if let Err(reason) = self.prepare_some() {
                    self.change.end(ChangePhase::Refused, reason);
                }
            }
            _ if behind => {
                if let Err(reason) = self.carry_some() {
                    self.change.end(ChangePhase::None, reason);
                }
            }
            _ => return self.exchange_versions(),
        }
        true
    }

    /// The version in the other bank takes the place of the running one. False if a task has a job.
    fn exchange_versions(&mut self) -> bool {
        let from = cycle::now();
        let now = self.now();
        let change = &mut self.change;
        let place = usize::from(change.record.program);
        let (Some(program), Some(other)) = (self.programs[place].as_mut(), change.other) else {
            change.end(ChangePhase::None, ChangeReason::Stopped);
            return true;
        };
        if change.is_leaving(change.record.program) {
            // A job of a version that has failed is skipped when its turn comes, which may be never.
            self.scheduler.abandon(program.id, now);
        }
        if !self.scheduler.is_between_jobs(program.id) {
            return false;
        }
        if let Way::InOneState { there, .. } = other.way {
            let mut memory = program.memory_of(&other.image, true);
            change.record.gone = Ready::new(there).apply(&mut memory);
        }
        let left = program.regions[STATE].area;
        // The way back from here leads to the version that was left.
        change.other = Some(program.exchange(other));
        change.carrying = Carrying::AFTER_EXCHANGE;
        self.events.follow(change.record.program, left, program.regions[STATE].area);
        for id in self.scheduler.ids() {
            let place = &mut self.places[id.index()];
            if place.program != change.record.program {
                continue;
            }
            let task = place.number.and_then(|n| program.image.task(takt_program::TaskId(n)));
            let entry = match place.number {
                Some(_) => task.map(|task| task.entry),
                None => program.image.init(),
            };
            if let Some(entry) = entry {
                place.start.entry = CODE + u64::from(entry.0);
            }
            if let Some(task) = task {
                self.scheduler.set_limits(id, &settings_of(program.id, &task));
            }
        }
        // The tables are entered anew, so no address of the version that was left is remembered.
        self.shown = Shown::NONE;
        change.record.phase = match change.record.phase {
            ChangePhase::Committing => ChangePhase::Trial,
            _ => ChangePhase::RolledBack,
        };
        change.record.jobs = 0;
        let to = cycle::now();
        let (took, at) = (self.clock.span(to.saturating_sub(from)), self.clock.instant(to));
        let first = self.scheduler.ids().find(|id| {
            let place = self.places[id.index()];
            usize::from(place.program) == usize::from(self.change.record.program)
                && place.number == Some(0)
        });
        let record = &mut self.change.record;
        (record.took, record.at) = (took.0, at.0);
        record.cycle = first.map_or(0, |id| self.scheduler.task(id).cycle());
        true
    }

    /// An error of a version on trial, or of one that is to be left, leads back to the one before. False if the task's is
    /// neither.
    pub fn trial_fails(&mut self, id: TaskId, reason: ChangeReason) -> bool {
        let place = self.places[id.index()];
        if !self.change.leads_back(place.program) {
            return false;
        }
        (self.change.record.phase, self.change.record.reason) = (ChangePhase::RollingBack, reason);
        let now: Instant = self.now();
        if let Some(program) = &self.programs[usize::from(place.program)] {
            self.scheduler.abandon(program.id, now);
        }
        self.abandon_outputs(place.program);
        true
    }
}
